"""`radiosity.compare` and `radiosity compare`: every method on a scene of one's own, told, stored, and cleared."""

import csv
import io
import json

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.compare_job import (
    COLUMNS,
    COMPARISON_KEY,
    IMAGE_NAME,
    advice,
    comparison_picture,
    comparison_table,
    read_comparison,
    show_comparison,
    trial_line,
)
from radiosity.addon.adapters.lettering import lettering
from radiosity.addon.command_line import main
from radiosity.core.settings import METHODS


@pytest.fixture
def room():
    """A closed white room with a lamp."""
    bpy.ops.mesh.primitive_cube_add(size=4)
    room = bpy.context.object
    room.name = "Room"
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.mesh.flip_normals()
    bpy.ops.object.mode_set(mode='OBJECT')
    bpy.ops.object.light_add(type='POINT', location=(0.5, 0.3, 1))
    bpy.context.object.data.energy = 15
    room.select_set(True)
    return room


@pytest.fixture
def scene_file(room, tmp_path):
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    return path


def names_of_data():
    kinds = ("objects", "meshes", "curves", "fonts", "images", "materials", "node_groups")
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}


def entry(method="auto", error=0.02, recommended=False, refusal=""):
    values = [method, 0.1, 0.5, 1000, error, error, error, error, recommended, refusal]
    return dict(zip(COLUMNS, values, strict=True))


def test_the_operator_stores_numbers_and_a_plot_and_no_light(room):
    bpy.context.scene.radiosity.quality = 'DRAFT'
    assert bpy.ops.radiosity.compare(places=30) == {'FINISHED'}
    found = read_comparison(bpy.context.scene)
    assert [trial["method"] for trial in found["trials"]] == list(METHODS)
    assert sum(trial["recommended"] for trial in found["trials"]) == 1
    assert found["asked"] == 0.1 and found["keeps"]
    image = bpy.data.images[IMAGE_NAME]
    assert image.packed_file is not None and tuple(image.size) == (1200, 800)
    assert not room.data.color_attributes and "radiosity_report" not in bpy.context.scene


def test_clear_leaves_nothing_of_a_comparison(room):
    before = names_of_data()
    scene = bpy.context.scene
    scene[COMPARISON_KEY] = json.dumps({"asked": 0.1, "keeps": True, "trials": [entry(recommended=True)]})
    show_comparison(read_comparison(scene), "Room")
    assert IMAGE_NAME in bpy.data.images
    assert bpy.ops.radiosity.clear() == {'FINISHED'}
    assert COMPARISON_KEY not in scene and names_of_data() == before


def test_a_second_plot_takes_the_place_of_the_first(room):
    comparison = {"asked": 0.1, "keeps": True, "trials": [entry(recommended=True)]}
    show_comparison(comparison, "one")
    show_comparison(comparison, "two")
    assert [image.name for image in bpy.data.images if image.name.startswith(IMAGE_NAME)] == [IMAGE_NAME]


def test_letters_leave_nothing_and_stand_on_their_base_line():
    before = names_of_data()
    lettering.cache_clear()
    edges, length = lettering("H")
    assert names_of_data() == before
    assert abs(edges[..., 1].min()) < 0.02 and 0.5 < edges[..., 1].max() < 1 and 0.3 < length < 1
    assert lettering("HH")[1] > 1.8 * length
    assert not len(lettering(" ")[0])


def test_where_every_method_was_refused_there_is_no_plot():
    comparison = {"asked": 0.1, "keeps": False, "trials": [entry(error=None, refusal="cannot")]}
    assert comparison_picture(comparison, "") is None and show_comparison(comparison, "") is None
    assert advice(comparison) == "no method could bake this scene"
    assert trial_line(comparison["trials"][0]) == "auto at 0.1: cannot"


def test_advice_says_when_nothing_keeps_the_accuracy():
    trials = [entry(error=0.2, recommended=True)]
    assert "none keeps the 0.1 asked for" in advice({"asked": 0.1, "keeps": False, "trials": trials})
    assert "none keeps" not in advice({"asked": 0.3, "keeps": True, "trials": trials})


def test_the_table_reads_back():
    trials = [entry("auto", 0.02, True), entry("disk", None, refusal="too large, sorry")]
    rows = list(csv.DictReader(io.StringIO(comparison_table({"asked": 0.1, "keeps": True, "trials": trials}))))
    assert tuple(rows[0]) == COLUMNS
    assert (rows[0]["measured_error"], rows[0]["recommended"]) == ("0.02", "True")
    assert (rows[1]["measured_error"], rows[1]["refusal"]) == ("", "too large, sorry")


def test_the_command_tells_each_bake_and_writes_what_is_named(scene_file, tmp_path, capfd):
    content = scene_file.read_bytes()
    table, image = tmp_path / "t.csv", tmp_path / "plot.png"
    options = ["--methods", "auto,Contour-Integral", "--accuracies", "0.3,0.2", "--accuracy", "0.2", "--places", "30"]
    assert main(["compare", str(scene_file), "--table", str(table), "--image", str(image), *options]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert len(lines) == 5 and all(line.startswith(f"{scene_file}: ") for line in lines)
    assert "auto at 0.3: " in lines[0] and "contour_integral at 0.2: " in lines[3] and "recommended" in lines[4]
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    assert [(row["method"], float(row["accuracy"])) for row in rows] == [
        ("auto", 0.3), ("auto", 0.2), ("contour_integral", 0.3), ("contour_integral", 0.2),
    ]  # fmt: skip
    assert image.read_bytes().startswith(b"\x89PNG")
    assert scene_file.read_bytes() == content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plot.png", "room.blend", "t.csv"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--methods", "magic"], "unknown method"),
        (["--accuracies", "0.1,x"], "--accuracies"),
        (["--accuracies", "0.1,9"], "Accuracy must lie"),
        (["--places", "3"], "--places must be 16 or more"),
        (["--table", "t.txt"], "must end in .csv"),
    ],
)
def test_wrong_arguments_are_refused_before_a_file_is_opened(options, said, capfd):
    assert main(["compare", "missing.blend", *options]) == 2
    assert said in capfd.readouterr().err


def test_a_dark_scene_says_so_and_writes_nothing(tmp_path, capfd):
    bpy.ops.mesh.primitive_plane_add()
    bpy.context.scene.world = None
    path, table = tmp_path / "dark.blend", tmp_path / "t.csv"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    assert main(["compare", str(path), "--table", str(table)]) == 1
    assert "Nothing in the scene emits light" in capfd.readouterr().err
    assert not table.exists()


def test_the_plot_shows_what_was_measured():
    comparison = {"asked": 0.1, "keeps": True, "trials": [entry("auto", 0.02, True), entry("disk", None, refusal="no")]}
    picture = comparison_picture(comparison, "Room")
    assert picture.shape == (800, 1200, 3) and picture.dtype == np.uint8
    without = comparison_picture({**comparison, "trials": comparison["trials"][:1]}, "Room")
    assert (picture != without).any()  # the refused one is in the legend
