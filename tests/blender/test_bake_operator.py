"""`radiosity.bake` from scripts: what it writes, what it leaves alone, what it refuses."""

import contextlib
import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters import bake_job
from radiosity.addon.adapters.bake_settings import BakeOptions, bake_options
from radiosity.core.bake import Progress
from radiosity.core.errors import RadiosityError, SettingsError
from radiosity.core.settings import BakeSettings
from radiosity.operators.step_runner import StepRunner, run_to_end


def grid(name, size=2.0, count=4, z=0.0):
    """A square of count x count faces that look up."""
    axis = np.linspace(-size / 2, size / 2, count + 1)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = np.stack([first, first + 1, first + count + 2, first + count + 1], axis=1)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    mesh.uv_layers.new(name="UVMap")
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(obj)
    obj.select_set(True)
    return obj


def lamp(power=100.0, z=2.0):
    light = bpy.data.lights.new("Lamp", 'POINT')
    light.energy = power
    obj = bpy.data.objects.new("Lamp", light)
    obj.location = 0.0, 0.0, z
    bpy.context.collection.objects.link(obj)
    return obj


@pytest.fixture
def floor():
    lamp()
    return grid("Floor")


@pytest.fixture
def options():
    return bake_options(bpy.context.scene.radiosity, quality="DRAFT", show_in_viewport=False)


def bake(**arguments):
    return bpy.ops.radiosity.bake(**{'quality': 'DRAFT', **arguments})


def colors(mesh, name="Radiosity"):
    attribute = mesh.attributes[name]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)


def snapshot(mesh):
    """All a bake could touch: attributes with their bytes in order, what is active, custom properties."""
    attributes = []
    for attribute in mesh.attributes:
        field, width, kind = {
            'FLOAT_COLOR': ("color", 4, np.float32),
            'BYTE_COLOR': ("color", 4, np.float32),
            'FLOAT_VECTOR': ("vector", 3, np.float32),
            'FLOAT2': ("vector", 2, np.float32),
            'FLOAT': ("value", 1, np.float32),
            'INT': ("value", 1, np.int32),
            'INT32_2D': ("value", 2, np.int32),
            'BOOLEAN': ("value", 1, bool),
        }[attribute.data_type]
        values = np.empty(width * len(attribute.data), kind)
        attribute.data.foreach_get(field, values)
        attributes.append((attribute.name, attribute.domain, attribute.data_type, values.tobytes()))
    group = mesh.attributes
    return (
        sorted(attributes),
        group.active_color_name,
        group.default_color_name,
        group.active.name if group.active else None,
        dict(mesh.items()),
        mesh.users,
    )


# What is written


@pytest.mark.parametrize("data_type", ['FLOAT_COLOR', 'BYTE_COLOR'])
@pytest.mark.parametrize("domain", ['CORNER', 'POINT'])
def test_bake_makes_the_attribute_active_and_render(floor, domain, data_type):
    assert bake(domain=domain, data_type=data_type) == {'FINISHED'}
    mesh = floor.data
    attribute = mesh.attributes["Radiosity"]
    assert (attribute.domain, attribute.data_type) == (domain, data_type)
    assert mesh.attributes.active_color_name == "Radiosity"
    assert mesh.attributes.default_color_name == "Radiosity"
    values = colors(mesh)
    assert len(values) == (len(mesh.loops) if domain == 'CORNER' else len(mesh.vertices))
    assert np.isfinite(values).all() and (values[:, 3] == 1).all()
    assert (values[:, :3] > 0).all()


def test_lighting_below_a_lamp_follows_the_inverse_square(floor):
    """E = I cos / d2 with I = power / (4 pi) watt per steradian; stored is E / pi."""
    bpy.context.scene.world = None
    bake(bake_type='DIRECT', quality='FINAL', domain='POINT')
    positions = np.array([vertex.co[:] for vertex in floor.data.vertices])
    distances = np.linalg.norm(positions - (0, 0, 2), axis=1)
    expected = 100 / (4 * np.pi**2) * (2 / distances) / distances**2
    # The lamp has Blender's default radius of 0.1 m, a sphere at 2 m: closed form within its (r/d)2 = 0.25 %.
    np.testing.assert_allclose(colors(floor.data)[:, 0], expected, rtol=0.01)


def test_same_bake_twice_gives_the_same_bits(floor):
    bake()
    first = snapshot(floor.data)
    bake()
    assert snapshot(floor.data) == first


def test_other_attributes_are_left_alone(floor):
    mesh = floor.data
    paint = mesh.color_attributes.new(name="Paint", type='BYTE_COLOR', domain='POINT')
    paint.data.foreach_set("color", np.linspace(0, 1, 4 * len(mesh.vertices), dtype=np.float32))
    mesh.attributes.new(name="weight", type='FLOAT', domain='POINT')
    before = {row[0]: row for row in snapshot(mesh)[0]}
    bake()
    after = {row[0]: row for row in snapshot(mesh)[0]}
    assert after.keys() - before.keys() == {"Radiosity"}
    assert {name: after[name] for name in before} == before


def test_attribute_of_other_domain_and_type_is_replaced(floor):
    bake(domain='POINT', data_type='BYTE_COLOR')
    bake(domain='CORNER', data_type='FLOAT_COLOR')
    (attribute,) = floor.data.color_attributes
    assert (attribute.name, attribute.domain, attribute.data_type) == ("Radiosity", 'CORNER', 'FLOAT_COLOR')
    assert floor.data.attributes.active_color_name == "Radiosity"


def test_point_and_corner_agree_on_a_smooth_floor(floor):
    bake(domain='CORNER', attribute_name="Corners")
    bake(domain='POINT', attribute_name="Points")
    mesh = floor.data
    vertices = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", vertices)
    # One plane: all corners of a vertex are one receiver, and a point is their mean, exact up to float32.
    np.testing.assert_allclose(colors(mesh, "Points")[vertices], colors(mesh, "Corners"), rtol=1e-6)


def test_byte_colors_hold_the_linear_value_and_clipping_is_counted(floor):
    bake(attribute_name="Floats")
    lit = colors(floor.data, "Floats")
    bpy.data.lights["Lamp"].energy *= 1.0 / lit[:, 0].mean()
    bake(attribute_name="Floats")
    bake(attribute_name="Bytes", data_type='BYTE_COLOR')
    wanted, stored = colors(floor.data, "Floats"), colors(floor.data, "Bytes")
    over = (wanted[:, :3] > 1 + 0.5 / 255).any(axis=1)
    assert 0 < over.sum() < len(over)
    # A step of 8-bit sRGB is at most 2.4 / 255 wide in linear light; rounding errs by half of it.
    np.testing.assert_allclose(stored, np.minimum(wanted, 1), atol=1.2 / 255)
    (warning,) = [text for text in report()["warnings"] if "brighter than white" in text]
    assert f" {over.sum()} of {len(over)} corners" in warning and "'Floor'" in warning


def report():
    return json.loads(bpy.context.scene["radiosity_report"])


def test_bake_types_add_up(floor):
    floor.data.materials.append(None)
    for bake_type in ('COMBINED', 'LIGHTING', 'DIRECT', 'INDIRECT', 'EMISSION'):
        bake(bake_type=bake_type, attribute_name=bake_type)
    part = {attribute.name: colors(floor.data, attribute.name)[:, :3] for attribute in floor.data.color_attributes}
    np.testing.assert_allclose(part['DIRECT'] + part['INDIRECT'], part['LIGHTING'], rtol=1e-5, atol=1e-7)
    assert not part['EMISSION'].any()
    ratio = part['COMBINED'] / part['LIGHTING']
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-4)  # one material: one reflectance


def test_only_selected_meshes_receive(floor):
    other = grid("Other", z=-1.0)
    other.select_set(False)
    bake()
    assert "Radiosity" in floor.data.attributes and "Radiosity" not in other.data.attributes


def test_with_nothing_selected_all_rendered_meshes_receive(floor):
    other, hidden = grid("Other", z=-1.0), grid("Hidden", z=-2.0)
    for obj in (floor, other, hidden):
        obj.select_set(False)
    hidden.hide_render = True
    bake()
    assert "Radiosity" in floor.data.attributes and "Radiosity" in other.data.attributes
    assert "Radiosity" not in hidden.data.attributes


# Arguments and settings


@pytest.mark.parametrize(
    ("given", "accuracy"),
    [
        ({'quality': 'DRAFT'}, 0.10),
        ({'quality': "final"}, 0.01),
        ({'accuracy': 0.02}, 0.02),
        ({'quality': "custom", 'accuracy': 0.2}, 0.2),
        ({'quality': None, 'accuracy': None}, 0.03),
    ],
)
def test_quality_and_accuracy(given, accuracy):
    assert bake_options(bpy.context.scene.radiosity, **given).settings.accuracy == accuracy


def test_custom_quality_takes_the_accuracy_of_the_scene():
    settings = bpy.context.scene.radiosity
    settings.quality, settings.accuracy = 'CUSTOM', 0.07
    assert bake_options(settings).settings.accuracy == 0.07
    assert bake_options(settings, quality="draft").settings.accuracy == 0.10


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({'quality': "best"}, "Unknown quality 'BEST'"),
        ({'quality': "draft", 'accuracy': 0.02}, "only one of them"),
        ({'accuracy': 5.0}, "Accuracy must lie between"),
        ({'accuracy': float("nan")}, "Accuracy must lie between"),
        ({'method': "magic"}, "Unknown method 'magic'"),
        ({'bake_type': "glossy"}, "Unknown bake type 'glossy'"),
        ({'domain': "edge"}, "Unknown domain 'EDGE'"),
        ({'data_type': "half"}, "Unknown data type 'HALF'"),
        ({'seed': -1}, "Seed must lie"),
        ({'threads': -2}, "Threads must be"),
        ({'world_strength': -1.0}, "World strength must be"),
        ({'world_strength': float("nan")}, "World strength must be"),
        ({'attribute_name': ""}, "needs a name"),
        ({'attribute_name': "x" * 68}, "67 bytes at most"),
        ({'attribute_name': "é" * 34}, "67 bytes at most"),
        ({'attribute_name': ".hidden"}, "starts? with a dot"),
        ({'attribute_name': "position"}, "Blender uses itself"),
        ({'attribute_name': "material_index"}, "Blender uses itself"),
    ],
)
def test_wrong_values_are_refused_by_name(given, text):
    with pytest.raises(SettingsError, match=text):
        bake_options(bpy.context.scene.radiosity, **given)


def test_misspelled_override_is_a_programming_error():
    with pytest.raises(TypeError, match="qualty"):
        bake_options(bpy.context.scene.radiosity, qualty="draft")


def test_choices_in_either_case_with_hyphens():
    options = bake_options(bpy.context.scene.radiosity, domain="point", data_type="byte", bake_type="Indirect")
    assert (options.domain, options.data_type, options.settings.bake_type) == ("POINT", "BYTE_COLOR", "indirect")


def test_world_strength_of_the_scene_counts_only_when_switched_on():
    settings = bpy.context.scene.radiosity
    settings.world_strength = 2.0
    assert bake_options(settings).world_strength is None
    settings.use_world_strength = True
    assert bake_options(settings).world_strength == 2.0
    assert bake_options(settings, world_strength=0.5).world_strength == 0.5


def test_arguments_override_the_scene_and_do_not_stick(floor):
    bpy.context.scene.radiosity.attribute_name = "Mine"
    bake(attribute_name="Once", domain='POINT')
    assert floor.data.attributes["Once"].domain == 'POINT' and "Mine" not in floor.data.attributes
    bpy.ops.radiosity.bake(quality='DRAFT')
    assert floor.data.attributes["Mine"].domain == 'CORNER'
    assert bpy.context.scene.radiosity.domain == 'CORNER'


def test_wrong_argument_of_the_operator_is_one_clear_error(floor):
    before = snapshot(floor.data)
    with pytest.raises(RuntimeError, match=r"Accuracy must lie between 0\.002 and 0\.5"):
        bpy.ops.radiosity.bake(accuracy=5.0)
    assert snapshot(floor.data) == before


# Refusals


def test_edit_mode_is_refused(floor):
    bpy.context.view_layer.objects.active = floor
    bpy.ops.object.mode_set(mode='EDIT')
    with pytest.raises(RuntimeError, match="Switch to Object Mode"):
        bake()
    bpy.ops.object.mode_set(mode='OBJECT')
    assert "Radiosity" not in floor.data.attributes


def test_name_of_an_attribute_of_another_kind_is_refused(floor):
    before = snapshot(floor.data)
    with pytest.raises(RuntimeError, match="'Floor' uses the name 'UVMap'"):
        bake(attribute_name="UVMap")
    assert snapshot(floor.data) == before


def test_name_of_a_vertex_group_is_refused(floor):
    floor.vertex_groups.new(name="Group")
    with pytest.raises(RuntimeError, match="vertex group named 'Group'"):
        bake(attribute_name="Group")


def test_refusals_come_before_the_bake(floor, options, monkeypatch):
    monkeypatch.setattr(bake_job, "bake_steps", lambda *_: pytest.fail("the slow part was reached"))
    with pytest.raises(SettingsError, match="UVMap"):
        run_to_end(bake_job.bake_job_steps(bpy.context, replace(options, attribute_name="UVMap")))


def test_no_light_names_the_remedy_and_changes_nothing():
    floor = grid("Floor")
    bpy.context.scene.world = None
    before = snapshot(floor.data)
    with pytest.raises(RuntimeError, match="light"):
        bake()
    assert snapshot(floor.data) == before and "radiosity_report" not in bpy.context.scene
    bake(world_strength=1.0)
    assert "Radiosity" in floor.data.attributes


def test_empty_scene_is_refused():
    with pytest.raises(RuntimeError, match="no mesh"):
        bake()


def test_foreign_attribute_of_that_name_is_overwritten_with_a_warning(floor):
    floor.data.color_attributes.new(name="Col", type='FLOAT_COLOR', domain='CORNER')
    bake(attribute_name="Col")
    assert any("'Col' that no bake had made" in text for text in report()["warnings"])
    bake(attribute_name="Col")
    assert not any("no bake had made" in text for text in report()["warnings"])


# All or nothing


@contextlib.contextmanager
def unchanged(*objects):
    scene = bpy.context.scene
    state = [(obj.data.name, snapshot(obj.data)) for obj in objects], sorted(scene.keys()), len(bpy.data.meshes)
    yield
    assert (
        [(obj.data.name, snapshot(obj.data)) for obj in objects],
        sorted(scene.keys()),
        len(bpy.data.meshes),
    ) == state


def failing_after(count, error):
    real = bake_job.bake_steps

    def steps(scene, settings):
        work = real(scene, settings)
        for _ in range(count):
            yield next(work)
        raise error

    return steps


@pytest.mark.parametrize("existing", [None, ('CORNER', 'FLOAT_COLOR'), ('POINT', 'BYTE_COLOR')])
@pytest.mark.parametrize("stage", ["read", "start", "middle", "colors", "write", "write_last"])
def test_error_at_any_stage_leaves_all_as_it_was(floor, options, monkeypatch, stage, existing):
    second = grid("Second", z=-1.0)
    if existing:
        for obj in (floor, second):
            old = obj.data.color_attributes.new(name="Radiosity", domain=existing[0], type=existing[1])
            old.data.foreach_set("color", np.linspace(0, 1, 4 * len(old.data), dtype=np.float32))
            obj.data.color_attributes.new(name="Active", domain='POINT', type='FLOAT_COLOR')
            obj.data.attributes.active_color_name = "Active"
    error = RadiosityError("made up")

    def fail(*_arguments, **_more):
        raise error

    if stage == "read":
        monkeypatch.setattr(bake_job, "read_scene", fail)
    elif stage in ("start", "middle"):
        monkeypatch.setattr(bake_job, "bake_steps", failing_after(0 if stage == "start" else 2, error))
    elif stage == "colors":
        calls = []
        monkeypatch.setattr(
            bake_job,
            "_values",
            lambda *a, f=bake_job._values: f(*a) if not calls.append(1) and len(calls) < 2 else fail(),
        )
    else:
        from radiosity.addon.adapters import color_attribute

        real, names = color_attribute._set_colors, []

        def set_colors(mesh, name, values):
            names.append(mesh.name)
            if mesh.name == "Second" and names.count("Second") == 1:
                if stage == "write_last":
                    real(mesh, name, values)
                raise error
            real(mesh, name, values)

        monkeypatch.setattr(color_attribute, "_set_colors", set_colors)
    with unchanged(floor, second), pytest.raises(RadiosityError, match="made up"):
        run_to_end(bake_job.bake_job_steps(bpy.context, options))


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_stop_half_way_leaves_all_as_it_was_and_a_new_bake_runs(floor, options, steps):
    with unchanged(floor):
        job = bake_job.bake_job_steps(bpy.context, options)
        for _ in range(steps):
            next(job)
        job.close()
    run_to_end(bake_job.bake_job_steps(bpy.context, options))
    assert "Radiosity" in floor.data.attributes


def steps_until_written(job):
    for progress in job:
        if progress.message == "Writing the colors":
            return
    pytest.fail("the bake never came to writing")


def test_mesh_edited_during_the_bake_is_refused(floor, options):
    job = bake_job.bake_job_steps(bpy.context, options)
    steps_until_written(job)
    floor.data.vertices.add(1)
    with unchanged(floor), pytest.raises(RadiosityError, match="'Floor' was edited during the bake"):
        next(job)


def test_object_removed_during_the_bake_is_refused(floor, options):
    second = grid("Second", z=-1.0)
    job = bake_job.bake_job_steps(bpy.context, options)
    steps_until_written(job)
    bpy.data.objects.remove(second)
    with unchanged(floor), pytest.raises(RadiosityError, match="'Second' was removed"):
        next(job)


def test_light_that_is_not_finite_is_not_written(floor, options, monkeypatch):
    monkeypatch.setattr(bake_job, "bake_steps", spoiled)
    with unchanged(floor), pytest.raises(RadiosityError, match="'Floor' is not finite"):
        run_to_end(bake_job.bake_job_steps(bpy.context, options))


class _Spoiled:
    name = "Floor"

    def corner_colors(self, bake_type):
        return np.full((64, 3), np.nan, np.float32)


def spoiled(scene, settings):
    yield Progress(0.5, "")
    return type("Result", (), {'meshes': [_Spoiled()], 'statistics': {}, 'warnings': []})()


# Shared meshes


@pytest.fixture
def twins(floor):
    twin = bpy.data.objects.new("Twin", floor.data)
    twin.location.z = -1.0
    bpy.context.collection.objects.link(twin)
    twin.select_set(True)
    return floor, twin


def test_shared_mesh_is_warned_about(twins):
    floor, twin = twins
    bake()
    assert twin.data == floor.data
    (skipped,) = report()["skipped"]
    assert skipped["object"] == "Twin" and "'Floor'" in skipped["reason"] and "Make Single User" in skipped["reason"]


def test_mesh_shared_with_an_object_that_is_not_baked_is_warned_about(twins):
    floor, twin = twins
    twin.select_set(False)
    bake()
    (warning,) = report()["warnings"]
    assert "share their mesh" in warning and "'Twin'" in warning and "'Floor'" not in warning
    bake(make_single_user=True)
    assert twin.data != floor.data and report()["warnings"] == []


def test_single_user_gives_each_object_its_own_light(twins):
    floor, twin = twins
    bake(make_single_user=True)
    assert twin.data != floor.data and (floor.data.users, twin.data.users) == (1, 1)
    assert report()["skipped"] == []
    # The twin lies in the shadow of the floor, one meter further from the lamp.
    assert colors(twin.data)[:, 0].mean() < 0.5 * colors(floor.data)[:, 0].mean()


def test_single_user_is_taken_back_when_writing_fails(twins, options, monkeypatch):
    def fail(*_arguments):
        raise RadiosityError("made up")

    monkeypatch.setattr(bake_job, "write_color_attributes", fail)
    with unchanged(*twins), pytest.raises(RadiosityError, match="made up"):
        run_to_end(bake_job.bake_job_steps(bpy.context, replace(options, make_single_user=True)))


# Stepping


def ticking(step=0.01):
    now = 0.0
    while True:
        yield now
        now += step


def work(count):
    for index in range(count):
        yield Progress(index / count, f"step {index}")
    return "done"


def test_runner_works_for_the_time_of_a_tick():
    clock = ticking()
    runner = StepRunner(work(20), clock=lambda: next(clock))
    assert not runner.advance(0.05)
    assert runner.message == "step 4"  # the clock ticks 0.01 at each look: one to set the end, five to reach it
    assert not runner.is_done


def test_runner_makes_at_least_one_step():
    runner = StepRunner(work(3))
    assert not runner.advance(0.0)
    assert runner.message == "step 0"


def test_runner_returns_the_result_and_foresees_the_end():
    seconds = iter(range(100))
    runner = StepRunner(work(4), clock=lambda: float(next(seconds)))  # starts at 0
    assert runner.seconds_left is None
    runner.advance(0.0)
    runner.advance(0.0)
    assert runner.fraction == 0.25
    left = runner.seconds_left  # at second 5: 5 s for a quarter
    assert left == pytest.approx(15.0)
    while not runner.advance(0.0):
        pass
    assert runner.result == "done" and runner.fraction == 1.0


def test_runner_never_goes_back():
    runner = StepRunner(iter_progress(0.5, 0.2, 0.7))
    fractions = []
    while not runner.advance(0.0):
        fractions.append(runner.fraction)
    assert fractions == [0.5, 0.5, 0.7]


def iter_progress(*fractions):
    for fraction in fractions:
        yield Progress(fraction, "")


def test_closing_the_runner_closes_the_work():
    closed = []

    def steps():
        try:
            while True:
                yield Progress(0.0, "")
        finally:
            closed.append(True)

    runner = StepRunner(steps())
    runner.advance(0.0)
    runner.close()
    assert closed == [True]


def test_progress_rises_from_zero_to_one(floor, options):
    seen = [(progress.fraction, progress.message) for progress in bake_job.bake_job_steps(bpy.context, options)]
    fractions = [fraction for fraction, _message in seen]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] <= 1
    assert all(message for _fraction, message in seen)


def test_options_reject_what_bake_options_would():
    with pytest.raises(SettingsError, match="domain"):
        BakeOptions(BakeSettings(), domain="EDGE")
