"""Real scenes made by other people, baked by the command line as their users would.

RADIOSITY_SCENES names the folder they lie in, as its README lists them; without it there is nothing to test.
"""

import json
import os
from pathlib import Path

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.picture import baked_pixels
from radiosity.addon.command_line import main

FOLDER = os.environ.get("RADIOSITY_SCENES")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not FOLDER, reason="RADIOSITY_SCENES names no folder with scenes"),
]

#: Each with the objects that it has to bake.
LIT = {
    "apartment/apartment.blend": 33,
    "cornell-box/CornellBox-Original.obj": 1,
    "garage/garage.blend": 1,
    "garage/garage.gltf": 1,
    "home-theater/home-theater.blend": 1,
    "living-room/living_room.blend": 2,
    "zdm2/zdm2.blend": 1,
}
UNLIT = {"home-theater/home-theater.gltf": 1, "living-room/living_room.glb": 2, "zdm2/zdm2.glb": 1}

#: Parts of the light that may be gained or lost by the sampled form factors of a draft.
BALANCE = 0.1


def run(*arguments):
    return main(["bake", *map(str, arguments)], "radiosity")


def pixels_of(name):
    """The baked scene that is open as (h, w) display values 0 to 1."""
    return baked_pixels(bpy.context, name, (320, 180)).mean(axis=2) / 255


@pytest.mark.parametrize("name", [*LIT, *UNLIT])
def test_scene_is_baked_whole_and_sane(name, tmp_path, capfd):
    light = ("--world-strength", 1) if name in UNLIT else ()
    results = [tmp_path / f"lit{suffix}" for suffix in (".blend", ".json", ".png")]
    options = [item for pair in zip(("--output", "--report", "--image"), results, strict=True) for item in pair]
    status = run(Path(FOLDER, name), *options, "--quality", "draft", *light)
    assert status == 0, capfd.readouterr().err

    report = json.loads(results[1].read_text(encoding="utf-8"))
    assert report["converged"]
    assert report["scene"]["baked_objects"] == (LIT | UNLIT)[name]
    assert report["scene"]["receivers"] > 0
    assert 0 < report["light_absorbed"] < 1 + BALANCE
    assert 0 <= report["light_escaped"] < 1 + BALANCE
    assert report["energy_balance_error"] < BALANCE
    assert report["closure_error_max"] < 1e-6  # exact but for rounding, whatever the scene
    assert 0 < report["estimated_error"] < 0.5

    bpy.ops.wm.open_mainfile(filepath=str(results[0]))
    baked = [made.data for made in bpy.data.objects if made.type == 'MESH' and "Radiosity" in made.data.attributes]
    assert len(baked) == report["scene"]["baked_objects"]
    brightest = 0.0
    for mesh in baked:
        attribute = mesh.attributes["Radiosity"]
        values = np.empty(4 * len(attribute.data), np.float32)
        attribute.data.foreach_get("color", values)
        assert np.isfinite(values).all()
        assert values.min() >= 0
        brightest = max(brightest, float(values.reshape(-1, 4)[:, :3].max()))
    assert brightest > 0
    assert json.loads(bpy.context.scene["radiosity_report"]) == report

    # Neither black nor white nor flat: a well exposed picture has its mean in the middle half, and shows something.
    shown = pixels_of("Radiosity")
    assert 0.1 < shown.mean() < 0.93
    assert shown.std() > 0.04
    assert results[2].stat().st_size > 10_000


@pytest.mark.parametrize("name", UNLIT)
def test_scene_without_light_says_so_and_what_helps(name, tmp_path, capfd):
    assert run(Path(FOLDER, name), "--output", tmp_path / "lit.blend") == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert name in line and "emits light" in line and "--world-strength 1" in line
    assert not list(tmp_path.iterdir())
