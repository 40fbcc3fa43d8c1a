"""The command line: what it accepts, what it writes, and what it says when it cannot."""

import io
import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters import scene_files
from radiosity.addon.adapters.console import ProgressLine, own_output
from radiosity.addon.command_line import build_parser, main, overrides
from radiosity.core.errors import RadiosityError
from radiosity.core.settings import BAKE_TYPES, METHODS

from tests.scenes import box, grid


def is_module():
    """Whether another Python process can load this package and bpy, too: not so inside the program."""
    try:
        return not bpy.app.binary_path and bool(version("radiosity"))
    except PackageNotFoundError:
        return False


needs_own_process = pytest.mark.skipif(not is_module(), reason="the package is not installed beside the bpy module")


def add_mesh(name, vertices, faces, emission=0.0):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices).tolist(), [], np.asarray(faces).tolist())
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"].inputs
    shader["Emission Color"].default_value = (1.0, 0.8, 0.6, 1.0)
    shader["Emission Strength"].default_value = emission
    mesh.materials.append(material)
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def fill_scene(emission=5.0):
    """A room of 1.5 m with a lamp hanging in it."""
    vertices, faces, _ = box((1.5, 1.5, 1.5), divisions=4)
    add_mesh("Room", vertices, faces)
    corners = ((0.5, 0.5, 1.2), (0.5, 1.0, 1.2), (1.0, 1.0, 1.2), (1.0, 0.5, 1.2))
    add_mesh("Lamp", *grid(corners, 2, 2), emission)
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = 64, 48


def save(path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path


@pytest.fixture
def room(tmp_path):
    fill_scene()
    (tmp_path / "in").mkdir()
    return save(tmp_path / "in" / "room.blend")


@pytest.fixture
def dark(tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    fill_scene(emission=0.0)
    (tmp_path / "in").mkdir(exist_ok=True)
    path = save(tmp_path / "in" / "dark.blend")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return path


def run(*arguments, opened=None):
    return main(["bake", *map(str, arguments)], "radiosity", opened)


def colors(name="Radiosity"):
    """Values of an attribute of the open file, by object."""
    found = {}
    for made in bpy.data.objects:
        attribute = made.data.color_attributes.get(name) if made.type == 'MESH' else None
        if attribute:
            found[made.name] = np.empty(4 * len(attribute.data), dtype=np.float32)
            attribute.data.foreach_get("color", found[made.name])
    return found


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_writes_what_was_named_and_nothing_else(room, tmp_path, capfd):
    with own_output(verbose=False):
        pass  # what Blender has kept back since its start comes out
    capfd.readouterr()
    before = room.read_bytes()
    results = [tmp_path / name for name in ("lit.blend", "lit.json", "lit.png")]
    assert run(room, "--output", results[0], "--report", results[1], "--image", results[2]) == 0
    said = capfd.readouterr()
    assert files(tmp_path) == ["in/room.blend", "lit.blend", "lit.json", "lit.png"]
    assert room.read_bytes() == before
    (line,) = said.out.splitlines()
    assert re.search(
        r"room\.blend: baked 2 objects, .* receivers in .* -> .*lit\.blend, .*lit\.json, .*lit\.png$", line
    )
    assert said.err == ""
    assert results[2].read_bytes().startswith(b"\x89PNG")
    report = json.loads(results[1].read_text(encoding="utf-8"))
    assert report["settings"]["attribute_name"] == "Radiosity"
    bpy.ops.wm.open_mainfile(filepath=str(results[0]))
    assert set(colors()) == {"Room", "Lamp"}
    assert json.loads(bpy.context.scene["radiosity_report"]) == report


def test_gives_the_same_bits_as_the_operator(room, tmp_path):
    assert run(room, "--output", tmp_path / "lit.blend", "--quality", "draft", "--bake", "lighting", "--seed", 3) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    by_command = colors()
    bpy.ops.wm.open_mainfile(filepath=str(room))
    assert bpy.ops.radiosity.bake(quality='DRAFT', bake_type='LIGHTING', seed=3) == {'FINISHED'}
    by_operator = colors()
    assert by_command.keys() == by_operator.keys() == {"Room", "Lamp"}
    for name, values in by_command.items():
        assert values.max() > 0
        np.testing.assert_array_equal(values, by_operator[name])


def test_stored_settings_hold_unless_an_option_replaces_them(tmp_path):
    fill_scene()
    settings = bpy.context.scene.radiosity
    settings.attribute_name, settings.domain, settings.quality = "Stored", 'POINT', 'DRAFT'
    room = save(tmp_path / "room.blend")
    assert run(room, "--report", tmp_path / "a.json", "--attribute", "Given", "--type", "byte") == 0
    report = json.loads((tmp_path / "a.json").read_text())["settings"]
    assert (report["attribute_name"], report["domain"], report["data_type"]) == ("Given", "POINT", "BYTE_COLOR")
    assert report["accuracy"] == 0.1
    assert run(room, "--report", tmp_path / "a.json", "--accuracy", 0.2) == 0
    report = json.loads((tmp_path / "a.json").read_text())["settings"]
    assert (report["attribute_name"], report["accuracy"]) == ("Stored", 0.2)


def select(*names):
    for made in bpy.data.objects:
        made.select_set(made.name in names)


def selected():
    return {made.name for made in bpy.data.objects if made.select_get()}


def test_a_stored_selection_does_not_limit_the_bake_and_is_kept(tmp_path):
    fill_scene()
    select("Lamp")
    room = save(tmp_path / "room.blend")
    assert run(room, "--output", tmp_path / "lit.blend", "--quality", "draft") == 0
    assert selected() == {"Lamp"}
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    assert set(colors()) == {"Room", "Lamp"}
    assert selected() == {"Lamp"}


def test_the_stored_selection_is_baked_when_asked_for(tmp_path, capfd):
    fill_scene()
    select("Lamp")
    room = save(tmp_path / "room.blend")
    assert run(room, "--output", tmp_path / "lit.blend", "--quality", "draft", "--selected") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    assert set(colors()) == {"Lamp"}
    select()
    save(room)
    capfd.readouterr()
    assert run(room, "--output", tmp_path / "none.blend", "--selected") == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert "No mesh is selected" in line and "--selected" in line
    assert not (tmp_path / "none.blend").exists()


def test_a_selection_outlives_a_bake_that_fails(tmp_path):
    fill_scene(emission=0.0)
    select("Lamp")
    assert run("--report", tmp_path / "a.json", opened=tmp_path / "open.blend") == 1
    assert selected() == {"Lamp"}


def test_a_file_saved_in_edit_mode_is_baked(tmp_path):
    fill_scene()
    for name in ("Room", "Lamp"):
        bpy.data.objects[name].select_set(True)
    bpy.context.view_layer.objects.active = bpy.data.objects["Lamp"]
    bpy.ops.object.mode_set(mode='EDIT')  # of both
    assert bpy.data.objects["Room"].mode == 'EDIT'
    room = save(tmp_path / "room.blend")
    assert run(room, "--output", tmp_path / "lit.blend", "--quality", "draft") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    assert set(colors()) == {"Room", "Lamp"}
    assert {made.mode for made in bpy.data.objects} == {'OBJECT'}


def test_edit_mode_is_left_by_an_object_that_is_not_active(tmp_path):
    fill_scene()
    room = bpy.data.objects["Room"]
    bpy.context.view_layer.objects.active = room
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.context.view_layer.objects.active = bpy.data.objects["Lamp"]
    assert run("--report", tmp_path / "a.json", "--quality", "draft", opened=tmp_path / "open.blend") == 0
    assert room.mode == 'OBJECT'
    assert set(colors()) == {"Room", "Lamp"}


def test_names_with_spaces_and_umlauts(tmp_path, capfd):
    fill_scene()
    folder = tmp_path / "Grüße aus Köln"
    folder.mkdir()
    room = save(folder / "mein Zimmer ß.blend")
    results = [folder / f"fertig ä{suffix}" for suffix in (".blend", ".json", ".png")]
    options = [item for pair in zip(("--output", "--report", "--image"), results, strict=True) for item in pair]
    assert run(room, *options, "--quality", "draft", "--attribute", "Wärme 1") == 0
    assert all(result.is_file() for result in results)
    assert "mein Zimmer ß.blend" in capfd.readouterr().out
    bpy.ops.wm.open_mainfile(filepath=str(results[0]))
    assert set(colors("Wärme 1")) == {"Room", "Lamp"}


def test_the_open_file_is_baked_when_none_is_named(room, tmp_path, capfd):
    assert run("--report", tmp_path / "a.json", opened=room) == 0
    assert capfd.readouterr().out.startswith(f"{room}: baked")


BAD = {
    "no file": ((), "name a scene file|IN"),
    "nothing to write": (("{room}",), "--output OUT.blend, --report R.json or --image I.png"),
    "unknown method": (("{room}", "--report", "{tmp}/a.json", "--method", "magic"), "choose from '?auto"),
    "unknown type of light": (("{room}", "--report", "{tmp}/a.json", "--bake", "shadow"), "combined.*emission"),
    "accuracy out of range": (("{room}", "--report", "{tmp}/a.json", "--accuracy", "3"), "between 0.002 and 0.5"),
    "accuracy not a number": (("{room}", "--report", "{tmp}/a.json", "--accuracy", "good"), "invalid float"),
    "two accuracies": (("{room}", "--report", "{tmp}", "--accuracy", "0.1", "--quality", "draft"), "not allowed"),
    "negative threads": (("{room}", "--report", "{tmp}/a.json", "--threads", "-2"), "[Tt]hreads"),
    "negative seed": (("{room}", "--report", "{tmp}/a.json", "--seed=-1"), "[Ss]eed"),
    "sky of no number": (("{room}", "--report", "{tmp}/a.json", "--world-strength", "nan"), "[Ww]orld strength"),
    "attribute without a name": (("{room}", "--report", "{tmp}/a.json", "--attribute", ""), "name"),
    "unknown option": (("{room}", "--report", "{tmp}/a.json", "--fast"), "unrecognized arguments: --fast"),
    "wrong ending": (("{room}", "--output", "{tmp}/a.obj"), "must end in .blend"),
    "no such folder": (("{room}", "--output", "{tmp}/none/a.blend"), "there is no folder"),
    "one file for two scenes": (("{room}", "{dark}", "--output", "{tmp}/a.blend"), "give a folder"),
    "the same result twice": (("{room}", "{room}", "--output", "{tmp}/out"), "two scenes would be written to"),
    "input in the way": (("{room}", "{dark}", "--output", "{tmp}/in"), "would be overwritten"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_in_one_line_before_anything_is_done(name, tmp_path, capfd):
    (tmp_path / "in").mkdir()
    places = {"room": tmp_path / "in" / "room.blend", "dark": tmp_path / "in" / "dark.blend", "tmp": tmp_path}
    for scene in ("room", "dark"):
        places[scene].write_bytes(b"never opened")
    arguments, pattern = BAD[name]
    assert run(*(argument.format(**places) for argument in arguments)) == 2
    said = capfd.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert re.search(pattern, line), line
    assert files(tmp_path) == ["in/dark.blend", "in/room.blend"]


def test_names_are_taken_with_hyphens_and_in_any_case():
    parse = build_parser("radiosity").parse_args
    arguments = parse(["bake", "a.blend", "--bake", "Combined", "--method", METHODS[-1].replace("_", "-").upper()])
    assert overrides(arguments) == {"bake_type": "combined", "method": METHODS[-1]}


def test_every_kind_of_light_can_be_asked_for():
    parse = build_parser("radiosity").parse_args
    for name in BAKE_TYPES:
        assert overrides(parse(["bake", "a.blend", "--bake", name])) == {"bake_type": name}


def test_in_a_batch_one_failure_is_named_and_the_others_go_on(room, dark, tmp_path, capfd):
    missing = tmp_path / "in" / "missing.blend"
    broken = tmp_path / "in" / "broken.blend"
    broken.write_text("no scene")
    assert run(dark, missing, broken, room, "--output", tmp_path / "out", "--quality", "draft") == 1
    said = capfd.readouterr()
    assert files(tmp_path / "out") == ["room.blend"]
    assert len(said.out.splitlines()) == 1
    errors = [line for line in said.err.splitlines() if line.startswith("radiosity: error:")]
    assert len(errors) == 3
    for path, line in zip((dark, missing, broken), errors, strict=True):
        assert str(path) in line
    assert "--world-strength" in errors[0] or "world" in errors[0].lower()
    assert "3 of 4 files failed" in said.err.splitlines()[-1]
    assert run(dark, "--output", tmp_path / "out/", "--quality", "draft", "--world-strength", 1) == 0


def test_a_file_may_be_replaced_by_its_baked_self_when_its_name_is_typed(room):
    assert run(room, "--output", room, "--quality", "draft") == 0
    bpy.ops.wm.open_mainfile(filepath=str(room))
    assert set(colors()) == {"Room", "Lamp"}
    assert files(room.parent) == ["room.blend"]


def test_windows_of_the_file_are_kept(tmp_path):
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    bpy.data.workspaces[0].name = "Mine"
    for made in list(bpy.data.objects):
        bpy.data.objects.remove(made)
    fill_scene()
    room = save(tmp_path / "room.blend")
    assert run(room, "--output", tmp_path / "lit.blend", "--quality", "draft") == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    assert "Mine" in bpy.data.workspaces


def test_scripts_in_a_file_run_only_when_asked_for(tmp_path):
    fill_scene()
    trace = tmp_path / "ran"
    text = bpy.data.texts.new("startup.py")
    text.write(f"open({str(trace)!r}, 'w').close()")
    text.use_module = True
    room = save(tmp_path / "room.blend")
    assert run(room, "--report", tmp_path / "a.json", "--quality", "draft") == 0
    assert not trace.exists()
    assert run(room, "--report", tmp_path / "a.json", "--quality", "draft", "--enable-scripts") == 0
    assert trace.exists()


def export(path):
    """Write the open scene in another format; False where this Blender cannot."""
    kind = path.suffix
    if kind == ".obj":
        bpy.ops.wm.obj_export(filepath=str(path))
    elif kind == ".ply":
        bpy.ops.wm.ply_export(filepath=str(path))
    elif kind in (".gltf", ".glb"):
        bpy.ops.export_scene.gltf(filepath=str(path), export_format='GLB' if kind == ".glb" else 'GLTF_SEPARATE')
    elif kind == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path))
    elif not bpy.app.build_options.usd:
        return False
    else:
        bpy.ops.wm.usd_export(filepath=str(path))
    return True


@pytest.mark.parametrize("kind", [kind for kind in scene_files.IMPORTERS if kind != ".usd"])
def test_other_formats_are_imported_and_baked(kind, tmp_path, capfd):
    fill_scene()
    path = tmp_path / f"room{kind}"
    if not export(path):
        pytest.skip("this Blender is built without the format")
    # A PLY has no materials, so that its only light is the sky.
    light = ("--world-strength", 1) if kind == ".ply" else ("--bake", "emission")
    status = run(path, "--output", tmp_path / "lit.blend", "--quality", "draft", *light)
    assert status == 0, capfd.readouterr().err
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "lit.blend"))
    baked = colors()
    assert baked
    # Lamps are as bright as they were exported: emission over pi is strength times color in every format.
    if kind != ".ply":
        assert max(values.max() for values in baked.values()) == pytest.approx(5.0, rel=1e-3)
    assert all(np.isfinite(values).all() for values in baked.values())


def test_unknown_formats_are_refused_by_name(tmp_path, capfd):
    path = tmp_path / "room.max"
    path.write_text("")
    assert run(path, "--output", tmp_path / "lit.blend") == 1
    assert re.search(r"room\.max is of an unknown kind: give one of \.blend, ", capfd.readouterr().err)


def test_ctrl_c_stops_without_writing(room, tmp_path, monkeypatch, capfd):
    update = ProgressLine.update

    def press(self, fraction, message):
        update(self, fraction, message)
        if fraction > 0.3:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ProgressLine, "update", press)
    before = signal.getsignal(signal.SIGINT)
    (tmp_path / "lit.blend").write_bytes(b"old")
    assert run(room, "--output", tmp_path / "lit.blend", "--report", tmp_path / "lit.json") == 130
    assert files(tmp_path) == ["in/room.blend", "lit.blend"]
    assert (tmp_path / "lit.blend").read_bytes() == b"old"
    assert "stopped" in capfd.readouterr().err
    assert signal.getsignal(signal.SIGINT) is before
    assert colors() == {}


@needs_own_process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of file size")
def test_a_full_disk_leaves_the_old_file_and_says_so(room, tmp_path):
    (tmp_path / "lit.blend").write_bytes(b"old")
    (tmp_path / "lit.json").write_bytes(b"old")
    # The largest file that may be written: enough for the report, not for the scene.
    code = "import resource, runpy, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
    code += "runpy.run_module('radiosity', run_name='__main__')"
    arguments = ["bake", room, "--output", tmp_path / "lit.blend", "--report", tmp_path / "lit.json"]
    command = [sys.executable, "-c", code, *map(str, arguments), "--quality", "draft"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 1, result.stderr
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("radiosity: error:")]
    assert "lit.blend cannot be written" in line
    assert files(tmp_path) == ["in/room.blend", "lit.blend", "lit.json"]
    assert (tmp_path / "lit.blend").read_bytes() == (tmp_path / "lit.json").read_bytes() == b"old"


@needs_own_process
def test_python_dash_m_keeps_standard_output_clean(room, tmp_path):
    command = [sys.executable, "-m", "radiosity", "bake", str(room), "--report", str(tmp_path / "a.json")]
    result = subprocess.run([*command, "--quality", "draft"], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert len(result.stdout.splitlines()) == 1
    verbose = subprocess.run([*command, "--quality", "draft", "--verbose"], capture_output=True, text=True, check=False)
    assert len(verbose.stdout.splitlines()) == 1
    refused = subprocess.run([*command, "--method", "magic"], capture_output=True, text=True, check=False)
    assert refused.returncode == 2


#: Lines of a process's status with the signals that it catches and ignores.
_HELD = ("SigCgt:", "SigIgn:")


def _wait_for_the_command(process):
    """Until our own code runs: what Python says when it is stopped while it starts, on a busy machine, is not ours."""
    status = Path(f"/proc/{process.pid}/status")
    if not status.exists():
        return  # no Linux: half a second must do
    for is_held in (True, False):  # Python catches the signal, or inherits that it is ignored; the command lets it go
        while process.poll() is None:
            lines = [line.split() for line in status.read_text().splitlines()]
            held = sum(int(line[1], 16) >> (signal.SIGINT - 1) & 1 for line in lines if line[0] in _HELD)
            if bool(held) == is_held:
                break


@needs_own_process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals between processes")
@pytest.mark.parametrize("seconds", [0.5, 1.0])
def test_ctrl_c_before_the_bake_ends_the_process_without_a_trace(seconds, room, tmp_path):
    command = [sys.executable, "-m", "radiosity", "bake", str(room), "--accuracy", "0.002", "--report", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    _wait_for_the_command(process)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(seconds)
    process.send_signal(signal.SIGINT)
    said = "".join(process.communicate())
    # Ended by the signal while Blender is loaded, by the command itself from then on.
    assert process.returncode in (-signal.SIGINT, 130)
    assert "Traceback" not in said
    assert files(tmp_path) == ["in/room.blend"]


@needs_own_process
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other pipes")
def test_a_reader_that_left_and_streams_that_are_closed_do_not_stop_a_bake(room, tmp_path):
    bake = f'{sys.executable} -m radiosity bake "{room}" --quality draft --report "{tmp_path}/%s.json"'
    for name, redirection in (("left", "| true; exit ${PIPESTATUS[0]}"), ("closed", "<&- >&- 2>&-")):
        command = ["bash", "-c", f"{bake % name} {redirection}"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
        assert (tmp_path / f"{name}.json").is_file()


def test_files_appear_together_or_not_at_all(tmp_path):
    first, second = tmp_path / "new" / "a.txt", tmp_path / "new" / "b.txt"
    seen = []

    def write(path):
        seen.append(path)
        path.write_text("complete")

    def fail(path):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(RadiosityError, match=r"b\.txt cannot be written: No space left on device"):
        scene_files.write_all_or_nothing({first: write, second: fail})
    assert files(tmp_path) == []
    scene_files.write_all_or_nothing({first: write, second: write})
    assert files(tmp_path) == ["new/a.txt", "new/b.txt"]
    assert {path.parent for path in seen} == {first.parent}  # relative paths in a file hold only there
    assert first not in seen
    mask = os.umask(0)
    os.umask(mask)
    assert first.stat().st_mode & 0o777 == 0o666 & ~mask  # as readable as any other file


def test_the_cause_of_a_failure_names_the_file_that_was_asked_for(tmp_path):
    target = tmp_path / "a.blend"

    def refuse(path):
        raise RadiosityError(f"Cannot open {path} for writing")

    with pytest.raises(RadiosityError) as caught:
        scene_files.write_all_or_nothing({target: refuse})
    assert str(caught.value) == f"{target} cannot be written: Cannot open {target} for writing"


MTL = "newmtl Lamp One\nKd 0 0 0\nKe 3 2 0.5\nnewmtl Wall\nKd 1 1 1\nKe 0 0 0\nnewmtl Plain\nKd 1 1 1\n"
OBJ = "mtllib my room.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n" + "".join(
    f"usemtl {name}\nf 1 2 3\n" for name in ("Lamp One", "Wall", "Plain")
)


def test_emission_of_obj_files_is_kept_in_every_version(tmp_path):
    (tmp_path / "my room.mtl").write_text(MTL)
    (tmp_path / "room.obj").write_text(OBJ)
    scene_files.open_scene(tmp_path / "room.obj")
    radiance = {}
    for material in bpy.data.materials:
        shader = next(node for node in material.node_tree.nodes if node.type == 'BSDF_PRINCIPLED').inputs
        color = np.array(shader["Emission Color"].default_value[:3])
        radiance[material.name] = color * shader["Emission Strength"].default_value
    np.testing.assert_allclose(radiance["Lamp One"], [3, 2, 0.5], rtol=1e-6)
    np.testing.assert_array_equal(radiance["Wall"], 0)
    np.testing.assert_array_equal(radiance["Plain"], 0)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_rewrites_one_line_on_a_terminal_and_is_sparse_elsewhere():
    now = [0.0]
    terminal, pipe = Terminal(), io.StringIO()
    lines = [ProgressLine("room.blend", stream, clock=lambda: now[0]) for stream in (terminal, pipe)]
    for step in range(1, 101):
        now[0] = step / 5  # 20 seconds in all
        for line in lines:
            line.update(step / 100, "Gathering" if step < 50 else "Done")
    lines[0].clear()
    assert "\n" not in terminal.getvalue()
    assert terminal.getvalue().count("\r") >= 100
    assert "room.blend:  50% Done, 10 s left" in terminal.getvalue()
    screen = ""  # what a terminal shows: a carriage return starts to write over the line
    for text in terminal.getvalue().split("\r"):
        screen = text + screen[len(text) :]
    assert screen.strip() == ""
    assert pipe.getvalue().splitlines() == [
        "room.blend:  25% Gathering, 15 s left",
        "room.blend:  50% Done, 10 s left",
        "room.blend:  75% Done, 5 s left",
        "room.blend: 100% Done, 0 s left",
    ]


def test_command_is_registered_and_taken_back():
    from radiosity.addon import command_line

    assert command_line._handle is not None
    command_line.unregister()
    assert command_line._handle is None
    command_line.register()
    assert command_line._handle is not None


def test_paths_are_independent_of_the_kind_of_slash(room, tmp_path):
    folder = f"{tmp_path}{os.sep}results{os.sep}"
    assert run(room, "--report", folder, "--quality", "draft") == 0
    assert Path(folder, "room.json").is_file()


@pytest.mark.parametrize("method", ["hemisphere", "contour-integral", "HEMICUBE"])
def test_method_by_name_bakes_and_is_told_in_the_report(room, tmp_path, method):
    report = tmp_path / "r.json"
    arguments = ["bake", str(room), "--report", str(report), "--quality", "draft", "--verify"]
    assert main([*arguments, "--method", method, "--solver", "gmres"]) == 0
    told = json.loads(report.read_text(encoding="utf-8"))
    name = method.lower().replace("-", "_")
    assert (told["settings"]["method"], told["settings"]["solver"]) == (name, "gmres")
    assert (told["method"], told["solver"]) == (name, "gmres") and told["polygons"] > 50
    # The accuracy that a draft asks for.
    assert told["measured_error_low"] < 0.1


def test_operator_and_command_line_give_the_same_bits_by_a_method(room, tmp_path):
    out = tmp_path / "out.blend"
    assert main(["bake", str(room), "--output", str(out), "--quality", "draft", "--method", "single-plane"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    first = colors()["Room"]
    bpy.ops.wm.open_mainfile(filepath=str(room))
    bpy.ops.radiosity.bake(quality='DRAFT', method='SINGLE_PLANE', show_in_viewport=False)
    assert np.array_equal(colors()["Room"], first)
