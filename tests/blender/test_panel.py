"""The tab: registered whole, every label and tooltip there, drawn without error in every state."""

import json

import bpy
import pytest
import radiosity
from radiosity.addon.panels import _classes as panel_classes
from radiosity.addon.panels import bake as bake_panel
from radiosity.addon.panels.statistics import _rows, wrapped
from radiosity.addon.properties.progress import ProgressState, duration, state

OPERATORS = ("bake", "stop", "subdivide", "preview_material", "clear", "mix_groups", "flatten_groups", "update")


def test_register_can_be_repeated():
    radiosity.unregister()
    assert not hasattr(bpy.types.Scene, "radiosity") and not hasattr(bpy.types, "VIEW3D_PT_radiosity")
    radiosity.register()
    radiosity.unregister()
    radiosity.register()
    assert bpy.context.scene.radiosity.attribute_name == "Radiosity"
    for name in OPERATORS:
        assert getattr(bpy.ops.radiosity, name).get_rna_type().identifier == f"RADIOSITY_OT_{name}"


def test_settings_are_kept_with_the_file(tmp_path):
    settings = bpy.context.scene.radiosity
    settings.quality, settings.domain, settings.attribute_name = 'FINAL', 'POINT', "Mine"
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert bpy.context.scene.radiosity.quality == 'PREVIEW'
    bpy.ops.wm.open_mainfile(filepath=path)
    settings = bpy.context.scene.radiosity
    assert (settings.quality, settings.domain, settings.attribute_name) == ('FINAL', 'POINT', "Mine")


def test_a_bake_that_ran_while_the_file_was_saved_does_not_run_when_it_is_opened(tmp_path):
    path = str(tmp_path / "scene.blend")
    state.start()
    assert bpy.context.window_manager.radiosity.is_running
    bpy.ops.wm.save_as_mainfile(filepath=path)
    state.finish()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert not bpy.context.window_manager.radiosity.is_running


def properties():
    for name in OPERATORS:
        for prop in getattr(bpy.ops.radiosity, name).get_rna_type().properties:
            yield f"radiosity.{name}", prop
    for struct in (bpy.context.scene.radiosity, bpy.context.window_manager.radiosity):
        for prop in struct.bl_rna.properties:
            if prop.identifier not in ('rna_type', 'name'):
                yield type(struct).__name__, prop


def test_everything_has_a_label_and_a_tooltip():
    seen = 0
    for owner, prop in properties():
        if prop.identifier == 'rna_type':
            continue
        where = f"{owner}.{prop.identifier}"
        assert prop.name and prop.name[0].isupper(), where
        assert prop.description and not prop.description.endswith("."), where
        if prop.type == 'ENUM':
            for item in prop.enum_items:
                assert item.name and item.description and not item.description.endswith("."), f"{where} {item.name}"
        seen += 1
    assert seen > 30
    for name in OPERATORS:
        described = getattr(bpy.ops.radiosity, name).get_rna_type().description
        assert described and not described.endswith("."), name


def test_arguments_of_the_bake_have_the_names_of_the_settings():
    arguments = {prop.identifier for prop in bpy.ops.radiosity.bake.get_rna_type().properties} - {'rna_type'}
    promised = {
        'quality', 'accuracy', 'method', 'solver', 'bake_type', 'attribute_name', 'domain', 'data_type', 'seed',
        'threads',
    }  # fmt: skip
    assert promised <= arguments
    assert all(bpy.ops.radiosity.bake.get_rna_type().properties[name].is_skip_save for name in arguments)
    assert arguments <= set(bpy.context.scene.radiosity.bl_rna.properties.keys())


class Layout:
    """Stands for a layout and checks what Blender would complain about: names of properties and operators."""

    def __init__(self, labels):
        self.__dict__.update(labels=labels)

    def row(self, **_more):
        return Layout(self.labels)

    column = split = row

    def label(self, text="", **_more):
        self.labels.append(text)

    def prop(self, data, name, **_more):
        assert name in data.bl_rna.properties, name
        self.labels.append(name)

    def operator(self, idname, **_more):
        module, name = idname.split(".")
        struct = getattr(getattr(bpy.ops, module), name).get_rna_type()
        self.labels.append(idname)
        return type("Properties", (), dict.fromkeys(struct.properties.keys()))()

    def progress(self, factor, text):
        assert 0 <= factor <= 1
        self.labels.append(text)


def draw(context=None):
    """Labels that the panels draw now, in order, through the real draw functions."""
    labels = []
    for cls in panel_classes():
        if hasattr(cls, "poll") and not cls.poll(context or bpy.context):
            continue
        panel = type("Panel", (), {**vars(cls), 'layout': Layout(labels)})
        instance = panel()
        instance.prepared_layout = lambda _context, layout=instance.layout: layout
        for step in ("draw_header", "draw"):
            if step in vars(cls):
                vars(cls)[step](instance, context or bpy.context)
    return labels


def test_panel_names_what_will_receive_the_light():
    assert "All rendered meshes receive light" in draw()
    bpy.ops.mesh.primitive_cube_add()
    assert "Receives light: Cube" in draw()
    bpy.ops.mesh.primitive_plane_add()
    bpy.ops.object.select_all(action='SELECT')
    assert "Receive light: 2 meshes" in draw()
    bpy.ops.object.mode_set(mode='EDIT')
    assert "Switch to Object Mode to bake" in draw()
    bpy.ops.object.mode_set(mode='OBJECT')


def test_panel_warns_of_a_shared_mesh_until_single_users_are_wanted():
    bpy.ops.mesh.primitive_cube_add()
    twin = bpy.context.object.copy()
    bpy.context.collection.objects.link(twin)
    twin.select_set(False)
    assert not any("share a mesh" in label for label in draw())
    twin.select_set(True)
    assert "2 share a mesh: Make Single User" in draw()
    bpy.context.scene.radiosity.make_single_user = True
    assert not any("share a mesh" in label for label in draw())


def test_panel_says_that_the_selection_has_no_faces():
    obj = bpy.data.objects.new("Empty", bpy.data.meshes.new("Empty"))
    bpy.context.collection.objects.link(obj)
    obj.select_set(True)
    assert "The selected meshes have no faces" in draw()


def test_accuracy_is_shown_for_custom_quality_only():
    assert "accuracy" not in draw()
    bpy.context.scene.radiosity.quality = 'CUSTOM'
    assert "accuracy" in draw()


def test_running_panel_shows_progress_and_stop_in_place_of_bake():
    state.start()
    try:
        state.fraction, state.message, state.seconds_left = 0.25, "Direct light", 75.0
        labels = draw()
        with pytest.raises(RuntimeError, match="A bake is running"):
            bpy.ops.radiosity.clear()
    finally:
        state.finish()
    assert "Direct light 25%, 1 min 15 s left" in labels
    assert "radiosity.stop" in labels and "radiosity.bake" not in labels
    assert "radiosity.bake" in draw()


def test_missing_ray_engine_is_said(monkeypatch):
    monkeypatch.setattr(bake_panel, "_has_ray_engine", lambda: False)
    assert "Ray engine embreex is missing" in draw()
    monkeypatch.setattr(bake_panel, "_has_ray_engine", lambda: True)
    assert "Ray engine embreex is missing" not in draw()


def test_statistics_show_the_last_report_and_its_warnings():
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4, size=2)
    bpy.ops.object.light_add(type='POINT', location=(0, 0, 2))
    bpy.context.view_layer.objects["Grid"].select_set(True)
    assert "Receivers" not in draw()
    bpy.ops.radiosity.bake(quality='DRAFT')
    report = json.loads(bpy.context.scene["radiosity_report"])
    rows = dict(_rows(report))
    assert rows["Receivers"] == "25" and rows["Converged"] == "Yes" and rows["Time"].endswith(" s")


def test_long_warnings_are_cut_between_words():
    assert wrapped("one two three four", 9) == ["one two", "three", "four"]
    assert wrapped("indivisible word", 4) == ["indivisible", "word"]
    assert wrapped("", 10) == [""]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (125, "2 min 5 s"), (3600, "1 h 0 min"), (-1, "0 s")],
)
def test_duration(seconds, text):
    assert duration(seconds) == text


def test_progress_starts_afresh():
    progress = ProgressState()
    progress.start()
    progress.stop_requested, progress.fraction = True, 0.5
    progress.finish()
    progress.start()
    assert progress.is_running and not progress.stop_requested and progress.fraction == 0
