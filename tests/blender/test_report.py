"""The report: one JSON document with the names that design and README promise."""

import json
import mmap

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters import memory
from radiosity.addon.adapters.memory import MemoryMeter, current_memory, peak_memory, physical_memory
from radiosity.addon.adapters.report import (
    REPORT_KEY,
    listed,
    make_report,
    messages,
    plain,
    radiosity_version,
    read_report,
    remove_report,
    store_report,
)


@pytest.fixture
def baked():
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=2)
    bpy.ops.object.light_add(type='POINT', location=(0, 0, 2))
    bpy.context.view_layer.objects["Grid"].select_set(True)
    bpy.ops.radiosity.bake(quality='DRAFT', attribute_name="Light", domain='POINT', seed=3, show_in_viewport=False)
    return json.loads(bpy.context.scene["radiosity_report"])


def test_report_has_all_that_is_promised(baked):
    assert baked["version"] == 1
    assert baked["blender_version"] == bpy.app.version_string
    assert baked["radiosity_version"] == radiosity_version()
    scene = baked["scene"]
    assert (scene["name"], scene["objects"], scene["faces"], scene["lights"]) == ("Scene", 1, 16, 1)
    assert scene["receivers"] == 25 and scene["baked_objects"] == 1
    assert scene["patches"] > 0 and scene["elements"] > 0
    assert baked["settings"] == {
        "accuracy": 0.1,
        "method": "auto",
        "solver": "auto",
        "bake_type": "combined",
        "seed": 3,
        "threads": 0,
        "time_limit": 0.0,
        "memory_limit": baked["settings"]["memory_limit"],
        "attribute_name": "Light",
        "domain": "POINT",
        "data_type": "FLOAT_COLOR",
        "world_strength": None,
        "make_single_user": False,
        "show_in_viewport": False,
        "light_groups": "NONE",
    }
    assert baked["converged"] is True and baked["rays"] > 0 and baked["iterations"] >= 1
    for name in (
        "light_absorbed", "energy_balance_error", "closure_error_max", "reciprocity_error_max", "estimated_error",
    ):  # fmt: skip
        assert isinstance(baked[name], float) and np.isfinite(baked[name]), name
    assert 0 <= baked["light_absorbed"] <= 1
    assert baked["warnings"] == [] and baked["skipped"] == []


def test_seconds_of_the_stages_add_up_to_the_total(baked):
    seconds = dict(baked["seconds"])
    total = seconds.pop("total")
    assert {"read", "write"} <= seconds.keys() and all(value >= 0 for value in seconds.values())
    # Stages do not overlap; the steps between them are what is missing. 1e-3: the core rounds each to 1e-4.
    assert sum(seconds.values()) <= total + 1e-3


def test_report_is_strict_json(baked):
    text = bpy.context.scene[REPORT_KEY]
    assert json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")) == baked


def test_plain_turns_numpy_and_what_is_not_finite():
    value = {
        "int": np.int64(3),
        "float": np.float32(0.5),
        "bool": np.bool_(True),
        "array": np.arange(3),
        "nan": float("nan"),
        "list": [np.inf, (1, 2)],
        4: None,
    }
    assert plain(value) == {
        "int": 3, "float": 0.5, "bool": True, "array": [0, 1, 2], "nan": None, "list": [None, [1, 2]], "4": None,
    }  # fmt: skip
    assert type(plain(np.bool_(True))) is bool


def made(**more):
    given = {
        'scene_name': "S", 'counts': {}, 'settings': {}, 'statistics': {}, 'seconds': {}, 'memory': (2, 1),
        'warnings': [], 'skipped': [],
    }  # fmt: skip
    return make_report(**{**given, **more})


def test_what_the_core_gives_passes_through():
    report = made(
        counts={"objects": 2, "lights": 1},
        statistics={"lights": 5, "patches": 7, "news": 1.5, "seconds": {"solve": 1.0}},
        seconds={"read": 0.5, "write": 0.25, "total": 2.0},
    )
    assert report["scene"] == {"name": "S", "objects": 2, "lights": 5, "patches": 7}
    assert report["news"] == 1.5
    assert list(report["seconds"].items()) == [("read", 0.5), ("solve", 1.0), ("write", 0.25), ("total", 2.0)]


def test_what_is_not_known_is_null_and_not_missing():
    report = made()
    assert report["estimated_error"] is None and report["light_absorbed"] is None and report["converged"] is None


def test_equal_warnings_are_merged_and_skipped_objects_grouped():
    report = made(
        warnings=["a", "b", "a"],
        skipped=[{"object": name, "reason": "has no faces"} for name in "AB"]
        + [{"object": "C", "reason": "is linked"}],
    )
    assert report["warnings"] == ["a", "b"]
    assert messages(report) == ["a", "b", "Skipped 'A', 'B': has no faces", "Skipped 'C': is linked"]


def test_long_lists_are_cut():
    assert listed(list("abc"), most=2) == "'a', 'b' and 1 more"
    assert listed(list("ab"), most=2) == "'a', 'b'"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 99}', 5])
def test_report_that_cannot_be_read_is_none(text):
    bpy.context.scene[REPORT_KEY] = text
    assert read_report(bpy.context.scene) is None


def test_report_is_stored_read_and_removed():
    scene = bpy.context.scene
    assert read_report(scene) is None and not remove_report(scene)
    store_report(scene, made())
    assert read_report(scene) == made()
    assert remove_report(scene) and REPORT_KEY not in scene


def test_memory_is_told_in_bytes():
    assert 10e6 < peak_memory() < physical_memory()
    # None where the system does not tell, as on macOS.
    assert current_memory() is None or 10e6 < current_memory() <= 1.01 * peak_memory()


def test_meter_sees_what_was_taken_and_given_back():
    meter = MemoryMeter()
    # Pages of its own: an array might get those that earlier tests have left to the process.
    with mmap.mmap(-1, int(60e6)) as block:
        np.frombuffer(block, np.uint8)[:] = 1
        meter.sample()
    _peak, above = meter.result()
    assert above >= 0.95 * 60e6


def test_meter_counts_from_the_start_and_not_from_an_older_peak(monkeypatch):
    now = {'current': 100, 'peak': 900}
    monkeypatch.setattr(memory, "current_memory", lambda: now['current'])
    monkeypatch.setattr(memory, "peak_memory", lambda: now['peak'])
    meter = MemoryMeter()
    now['current'] = 400
    meter.sample()
    now['current'] = 200
    assert meter.result() == (900, 300)
    now['peak'] = 1000  # raised by this work: exact
    assert meter.result() == (1000, 900)
