"""Scenes as arrays: what blocks, what receives, where it stands and which way it faces."""

from math import pi

import bpy
import numpy as np
import pytest
from radiosity.addon.adapters.scene_reader import read_scene
from radiosity.core.errors import EmptySceneError, RadiosityError


def link(obj, collection=None):
    (collection or bpy.context.collection).objects.link(obj)
    return obj


def cube_mesh(size=2.0, name="Cube"):
    """A closed cube around the origin, faces outward."""
    half = size / 2
    corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    return mesh


def add_cube(name="Cube", location=(0, 0, 0), rotation=(0, 0, 0), scale=(1, 1, 1), mesh=None):
    obj = bpy.data.objects.new(name, mesh or cube_mesh())
    obj.location, obj.rotation_euler, obj.scale = location, rotation, scale
    link(obj)
    bpy.context.view_layer.update()
    return obj


def volume(surfaces, name=None):
    """Signed volume within the triangles (of one object): positive where they face outward."""
    chosen = slice(None) if name is None else surfaces.objects == list(surfaces.object_names).index(name)
    a, b, c = np.moveaxis(surfaces.vertices[surfaces.triangles[chosen]], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def names_that_block(reading):
    surfaces = reading.scene.surfaces
    return {surfaces.object_names[row] for row in np.unique(surfaces.objects)}


def diffuse(name, color):
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # always there from Blender 5.0
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new('ShaderNodeBsdfDiffuse'), tree.nodes.new('ShaderNodeOutputMaterial')
    shader.inputs["Color"].default_value = (*color, 1)
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


SCALES = [(1, 1, 1), (2, 0.5, 3), (-1, 1, 1), (-2, -0.5, -3), (-1, -1, 2)]


@pytest.mark.parametrize("scale", SCALES)
def test_triangles_and_normals_face_outward_under_any_scale(scale):
    obj = add_cube(location=(5, -3, 2), rotation=(0.3, 0.7, -0.4), scale=scale)
    reading = read_scene(bpy.context, receivers=[obj])
    assert volume(reading.scene.surfaces) == pytest.approx(8 * abs(np.prod(scale)), rel=1e-5)
    (mesh,) = reading.scene.receivers
    assert mesh.flipped == (np.prod(scale) < 0)
    outward = mesh.positions[mesh.corner_vertices] - np.array(obj.location)
    assert (np.einsum("ij,ij->i", outward, mesh.normals_at()) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals_at(), axis=1), 1, rtol=1e-6)
    # Flat faces: the normal is at right angles to the face's edges, which only the inverse transpose gets right.
    corners = mesh.positions[mesh.corner_vertices].reshape(-1, 4, 3)
    edges = np.diff(corners, axis=1)
    normals = mesh.normals_at().reshape(-1, 4, 3)[:, :3]
    np.testing.assert_allclose(np.einsum("fij,fij->fi", edges, normals), 0, atol=1e-5)


def test_flattened_object_keeps_its_normals():
    obj = add_cube(scale=(1, 1, 0))
    (mesh,) = read_scene(bpy.context, receivers=[obj]).scene.receivers
    top = np.abs(mesh.normals_at()[:, 2]) == 1
    assert top.sum() == 8
    assert np.isfinite(mesh.normals_at()).all()


def test_world_positions_keep_what_float32_holds_far_away():
    """The matrix is float32, the product is not: corners of a cube 1e5 away differ by its size to 1e-9."""
    obj = add_cube(location=(1e5, 0, 0), mesh=cube_mesh(0.001))
    surfaces = read_scene(bpy.context, receivers=[obj]).scene.surfaces
    assert np.ptp(surfaces.vertices[:, 0]) == pytest.approx(0.001, rel=1e-6)


def hide_in_render(obj):
    obj.hide_render = True


def hide_monitor(obj):
    obj.hide_viewport = True


def hide_eye(obj):
    obj.hide_set(True)


def in_collection(**switches):
    def change(obj):
        collection = bpy.data.collections.new("Inner")
        bpy.context.scene.collection.children.link(collection)
        for other in obj.users_collection:
            other.objects.unlink(obj)
        collection.objects.link(obj)
        for name, value in switches.items():
            owner = collection if name != "exclude" and name != "eye" else None
            if owner is None:
                layer = bpy.context.view_layer.layer_collection.children["Inner"]
                setattr(layer, {"eye": "hide_viewport"}.get(name, name), value)
            else:
                setattr(owner, name, value)

    return change


@pytest.mark.parametrize(
    ("hide", "blocks"),
    [
        (hide_in_render, False),
        (hide_monitor, True),
        (hide_eye, True),
        (in_collection(hide_render=True), False),
        (in_collection(hide_viewport=True), True),
        (in_collection(eye=True), True),
        (in_collection(exclude=True), False),
        (in_collection(hide_viewport=True, hide_render=True), False),
    ],
    ids=["render", "monitor", "eye", "collection render", "collection monitor", "collection eye", "exclude", "both"],
)
def test_what_renders_blocks_and_nothing_changes_for_the_artist(hide, blocks):
    floor = add_cube("Floor")
    other = add_cube("Other", location=(5, 0, 0))
    hide(other)
    bpy.context.view_layer.update()

    def state():
        view_layer = bpy.context.view_layer
        layers = [view_layer.layer_collection, *view_layer.layer_collection.children]
        collections = [(each.hide_viewport, each.exclude, each.collection.hide_viewport) for each in layers]
        objects = [(each.name, each.hide_viewport, each.hide_get(), each.visible_get()) for each in (floor, other)]
        return collections, objects, sorted(view_layer.objects.keys())

    before = state()
    reading = read_scene(bpy.context, receivers=[floor])
    assert ("Other" in names_that_block(reading)) == blocks
    assert state() == before


def test_state_comes_back_when_reading_fails():
    other = add_cube("Other")
    other.hide_viewport = True
    with pytest.raises(EmptySceneError):
        read_scene(bpy.context, receivers=[])
    assert other.hide_viewport


def instance(collection, location=(0, 0, 0), scale=(1, 1, 1), name="Instance"):
    empty = link(bpy.data.objects.new(name, None))
    empty.instance_type = 'COLLECTION'
    empty.instance_collection = collection
    empty.location, empty.scale = location, scale
    return empty


def test_collection_instances_block_where_they_stand():
    floor = add_cube("Floor")
    outer, inner = (bpy.data.collections.new(name) for name in ("Outer", "Inner"))
    outer.children.link(inner)
    link(bpy.data.objects.new("Seen", cube_mesh()), outer)
    link(bpy.data.objects.new("Not in render", cube_mesh()), outer).hide_render = True
    link(bpy.data.objects.new("Not in viewport", cube_mesh()), inner).hide_viewport = True
    instance(outer, (10, 0, 0), (1, 1, 2))
    instance(outer, (20, 0, 0), (-1, 1, 1))
    reading = read_scene(bpy.context, receivers=[floor])
    assert names_that_block(reading) == {"Floor", "Seen", "Not in viewport"}
    surfaces = reading.scene.surfaces
    assert volume(surfaces, "Seen") == pytest.approx(16 + 8)
    inside = surfaces.objects == list(surfaces.object_names).index("Seen")
    x = surfaces.vertices[surfaces.triangles[inside]][..., 0]
    assert (x.min(), x.max()) == (9, 21)
    assert reading.counts["objects"] == 5
    assert bpy.data.objects["Not in viewport"].hide_viewport


def test_children_on_vertices_block_there_and_not_where_their_pattern_stands():
    floor = add_cube("Floor")
    parent, child = add_cube("Parent", location=(9, 0, 0)), add_cube("Child")
    child.parent = parent
    parent.instance_type = 'VERTS'
    parent.show_instancer_for_viewport = False
    parent.show_instancer_for_render = True
    bpy.context.view_layer.update()
    shown = read_scene(bpy.context, receivers=[floor])
    assert names_that_block(shown) == {"Floor", "Parent", "Child"}
    assert shown.counts["objects"] == 1 + 1 + 8
    assert not parent.show_instancer_for_viewport
    child.hide_render = True
    assert names_that_block(read_scene(bpy.context, receivers=[floor])) == {"Floor", "Parent"}


def test_curves_surfaces_text_and_metaballs_block():
    floor = add_cube("Floor")
    for add in (
        lambda: bpy.ops.curve.primitive_bezier_circle_add(location=(9, 0, 0)),
        lambda: bpy.ops.object.text_add(location=(9, 9, 0)),
        lambda: bpy.ops.object.metaball_add(location=(0, 9, 0)),
        lambda: bpy.ops.surface.primitive_nurbs_surface_torus_add(location=(0, 0, 9)),
    ):
        add()
    curve = bpy.data.objects["BézierCircle"] if "BézierCircle" in bpy.data.objects else bpy.data.objects["BezierCircle"]
    curve.data.bevel_depth = 0.1
    names = names_that_block(read_scene(bpy.context, receivers=[floor]))
    assert names == {"Floor", curve.name, "Text", "Mball", "SurfTorus"}


def test_modifiers_shape_what_blocks_and_the_base_mesh_receives():
    obj = add_cube()
    obj.modifiers.new("Array", 'ARRAY').relative_offset_displace = (3, 0, 0)
    warp = obj.modifiers.new("Move", 'DISPLACE')
    warp.direction, warp.strength, warp.mid_level = 'X', 1.0, 0.0
    reading = read_scene(bpy.context, receivers=[obj])
    assert len(reading.scene.surfaces.triangles) == 24
    (mesh,) = reading.scene.receivers
    assert len(mesh.positions) == 8
    # The displacement still moves the base mesh, by 1 m.
    np.testing.assert_allclose(mesh.positions[:, 0].mean(), 1, rtol=1e-6)
    assert [text for text in reading.scene.warnings if "Cube (Array)" in text]
    assert all(modifier.show_viewport for modifier in obj.modifiers)


def test_deformed_mesh_receives_where_it_stands_without_a_warning():
    obj = add_cube()
    warp = obj.modifiers.new("Move", 'DISPLACE')
    warp.direction, warp.strength, warp.mid_level = 'Z', 2.0, 0.0
    reading = read_scene(bpy.context, receivers=[obj])
    np.testing.assert_allclose(reading.scene.receivers[0].positions[:, 2].mean(), 2, rtol=1e-6)
    assert reading.scene.warnings == ()


def test_smooth_sharp_and_custom_normals_come_per_corner():
    smooth, sharp, custom = (add_cube(name, location=(4 * i, 0, 0)) for i, name in enumerate("ABC"))
    for obj in (smooth, sharp, custom):
        obj.data.polygons.foreach_set("use_smooth", [True] * 6)
    sharp.data.edges.foreach_set("use_edge_sharp", [True] * 12)
    custom.data.normals_split_custom_set([(0.0, 0.0, 1.0)] * 24)
    for obj in (smooth, sharp, custom):
        obj.data.update()
    meshes = read_scene(bpy.context, receivers=[smooth, sharp, custom]).scene.receivers
    corner = np.abs(meshes[0].normals_at())
    np.testing.assert_allclose(corner, 1 / np.sqrt(3), atol=1e-3)
    assert (np.abs(meshes[1].normals_at()).max(1) > 0.9999).all()
    np.testing.assert_allclose(meshes[2].normals_at(), np.tile([0, 0, 1], (24, 1)), atol=1e-3)


def test_broken_geometry_is_read_as_it_is():
    mesh = bpy.data.meshes.new("Broken")
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (float("nan"), 0, 0), (float("inf"), 1, 1), (2, 2, 2), (9, 9, 9)]
    mesh.from_pydata(points, [(5, 6)], [(0, 1, 2), (0, 1, 3), (1, 2, 4), (0, 0, 1)])
    obj = link(bpy.data.objects.new("Broken", mesh))
    reading = read_scene(bpy.context, receivers=[obj])
    assert len(reading.scene.surfaces.triangles) == 4
    assert reading.scene.receivers[0].positions.shape == (7, 3)
    assert np.isnan(reading.scene.receivers[0].positions).any()


def test_ngons_are_cut_to_their_own_area():
    angles = np.arange(7) * 2 * pi / 7
    radius = np.where(np.arange(7) == 3, 0.1, 1.0)  # concave
    outline = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(7)])
    mesh = bpy.data.meshes.new("Ngon")
    mesh.from_pydata(outline.tolist(), [], [tuple(range(7))])
    obj = link(bpy.data.objects.new("Ngon", mesh))
    reading = read_scene(bpy.context, receivers=[obj])
    corners = reading.scene.surfaces.vertices[reading.scene.surfaces.triangles]
    assert len(corners) == 5
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    x, y, _ = outline.T
    assert areas.sum() == pytest.approx((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2, rel=1e-6)
    np.testing.assert_array_equal(reading.scene.receivers[0].face_offsets, [0, 7])


# Materials on meshes


def test_slots_of_mesh_and_object_and_empty_slots():
    mesh = cube_mesh()
    red, green = diffuse("Red", (0.5, 0, 0)), diffuse("Green", (0, 0.5, 0))
    for material in (red, None, red):
        mesh.materials.append(material)
    obj = add_cube(mesh=mesh)
    obj.material_slots[2].link = 'OBJECT'
    obj.material_slots[2].material = green
    mesh.polygons.foreach_set("material_index", [0, 0, 1, 1, 2, 2])
    bpy.context.view_layer.update()
    reading = read_scene(bpy.context, receivers=[obj])
    surfaces = reading.scene.surfaces
    expected = np.repeat([(0.5, 0, 0), (0.8, 0.8, 0.8), (0, 0.5, 0)], 4, axis=0)
    np.testing.assert_allclose(surfaces.reflectance[surfaces.palette_rows], expected, rtol=1e-6)
    assert len(set(surfaces.materials.tolist())) == 3
    (receiver,) = reading.scene.receivers
    np.testing.assert_allclose(receiver.palette_reflectance[receiver.face_materials], expected[::2], rtol=1e-6)
    assert receiver.corner_reflectance is None


def test_equal_looks_have_equal_numbers_across_objects_and_materials():
    for i, color in enumerate([(0.5, 0, 0), (0.5, 0, 0), (0, 0.5, 0)]):
        mesh = cube_mesh()
        mesh.materials.append(diffuse(f"M{i}", color))
        add_cube(f"C{i}", mesh=mesh)
    surfaces = read_scene(bpy.context).scene.surfaces
    first, second, third = (
        set(surfaces.materials[surfaces.objects == list(surfaces.object_names).index(f"C{i}")]) for i in range(3)
    )
    assert first == second != third


def test_material_override_of_the_view_layer_is_worn_by_all():
    obj = add_cube()
    bpy.context.view_layer.material_override = diffuse("Override", (0.1, 0.2, 0.3))
    reading = read_scene(bpy.context, receivers=[obj])
    np.testing.assert_allclose(
        reading.scene.surfaces.reflectance[reading.scene.surfaces.palette_rows], [(0.1, 0.2, 0.3)] * 12, rtol=1e-6
    )
    np.testing.assert_allclose(reading.scene.receivers[0].palette_reflectance, [(0.1, 0.2, 0.3)], rtol=1e-6)


def textured_square(name, image, location=(0, 0, 0), scale=(1, 1, 1)):
    """A square of two triangles with UV 0 to 1 and an image as its color."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new().uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], dtype=np.float32))
    material = diffuse(name, (0, 0, 0))
    tree = material.node_tree
    node = tree.nodes.new('ShaderNodeTexImage')
    node.image = image
    shader = next(each for each in tree.nodes if each.bl_idname == 'ShaderNodeBsdfDiffuse')
    tree.links.new(node.outputs["Color"], shader.inputs["Color"])
    mesh.materials.append(material)
    obj = bpy.data.objects.new(name, mesh)
    obj.location, obj.scale = location, scale
    return link(obj)


def ramp_image():
    """Red rises with u, green with v: the color of a point tells its UV."""
    image = bpy.data.images.new("Ramp", 64, 64, float_buffer=True)
    image.colorspace_settings.name = 'Linear Rec.709'
    ticks = (np.arange(64) + 0.5) / 64
    pixels = np.ones((64, 64, 4), dtype=np.float32)
    pixels[..., 0], pixels[..., 1], pixels[..., 2] = ticks[None, :], ticks[:, None], 0.25
    image.pixels.foreach_set(pixels.ravel())
    return image


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1)])
def test_shader_tells_the_color_at_each_point_of_textured_triangles(scale):
    image = ramp_image()
    squares = [textured_square(name, image, (i * 3, 0, 0), scale) for i, name in enumerate("ABC")]
    plain = add_cube("Plain", location=(0, 9, 0))
    squares[1].data.materials[0] = squares[0].data.materials[0]
    tree = squares[2].data.materials[0].node_tree
    invert = tree.nodes.new('ShaderNodeInvert')
    picture = next(each for each in tree.nodes if each.bl_idname == 'ShaderNodeTexImage')
    shader = next(each for each in tree.nodes if each.bl_idname == 'ShaderNodeBsdfDiffuse')
    tree.links.new(picture.outputs["Color"], invert.inputs["Color"])
    tree.links.new(invert.outputs["Color"], shader.inputs["Color"])
    reading = read_scene(bpy.context, receivers=[*squares, plain])
    surfaces = reading.scene.surfaces
    assert surfaces.textured.sum() == 6
    random = np.random.default_rng(0)
    rows = random.choice(np.flatnonzero(surfaces.textured), 200)
    weights = random.dirichlet((1, 1, 1), 200)
    points = np.einsum("nc,nck->nk", weights, surfaces.vertices[surfaces.triangles[rows]])
    names = np.array(surfaces.object_names)[surfaces.objects[rows]]
    places = np.array([3 * "ABC".index(name) for name in names])
    local = (points - places[:, None] * np.array([1, 0, 0])) * np.array(scale)
    reflectance, emission, transmittance = surfaces.shader(rows, weights)
    inside = (local[:, :2] > 1 / 64).all(1) & (local[:, :2] < 1 - 1 / 64).all(1)  # the border pixels wrap around
    inverted = (names == "C")[:, None]
    expected = np.where(inverted, 1 - local[:, :2], local[:, :2])  # C wears a material of its own, which inverts
    np.testing.assert_allclose(reflectance[inside, :2], expected[inside], atol=1e-5)
    assert not emission.any()
    assert not transmittance.any()
    # Means over the two triangles, whose centers are at a third and two thirds.
    means = surfaces.reflectance[surfaces.palette_rows[surfaces.textured]]
    np.testing.assert_allclose(np.sort(means[:2, 0]), (1 / 3, 2 / 3), atol=0.01)
    np.testing.assert_allclose(np.sort(means[:, 2]), (0.25, 0.25, 0.25, 0.25, 0.75, 0.75), rtol=1e-5)
    assert len(set(surfaces.materials[surfaces.textured].tolist())) == 3
    square, _, _, cube = reading.scene.receivers
    assert square.corner_reflectance.shape == (4, 3)
    assert cube.corner_reflectance is None
    np.testing.assert_allclose(square.corner_reflectance[:, 2], 0.25, rtol=1e-5)


# Receivers


def test_selected_meshes_receive_and_others_are_named():
    chosen, other = add_cube("Chosen"), add_cube("Other")
    lamp = link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", 'POINT')))
    empty = link(bpy.data.objects.new("Empty mesh", bpy.data.meshes.new("Nothing")))
    for obj in (chosen, lamp, empty):
        obj.select_set(True)
    other.select_set(False)
    reading = read_scene(bpy.context)
    assert reading.targets == ("Chosen",)
    assert {name for name, _ in reading.skipped} == {"Lamp", "Empty mesh"}
    assert names_that_block(reading) == {"Chosen", "Other"}


def test_all_rendered_meshes_receive_where_none_is_selected():
    add_cube("A")
    add_cube("B")
    add_cube("Hidden").hide_render = True
    lamp = link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", 'POINT')))
    lamp.select_set(True)
    reading = read_scene(bpy.context)
    assert set(reading.targets) == {"A", "B"}
    assert reading.counts["receivers"] == 2
    assert reading.counts["faces"] == 12
    assert reading.counts["triangles"] == 24
    assert reading.counts["lights"] == 1


def test_one_of_two_objects_with_one_mesh_receives():
    mesh = cube_mesh()
    first, second = add_cube("First", mesh=mesh), add_cube("Second", location=(5, 0, 0), mesh=mesh)
    reading = read_scene(bpy.context, receivers=[first, second, first])
    assert reading.targets == ("First",)
    assert reading.shared == (("Second", "First"),)
    ((name, reason),) = reading.skipped
    assert name == "Second"
    assert "single-user" in reason
    assert reading.counts["objects"] == 2
    assert reading.counts["meshes"] == 1


def test_mesh_from_another_file_is_skipped(tmp_path):
    mesh = cube_mesh(name="Far")
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {mesh}, fake_user=True)
    bpy.data.meshes.remove(mesh)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.meshes = ["Far"]
    linked = link(bpy.data.objects.new("Linked", wanted.meshes[0]))
    own = add_cube("Own")
    reading = read_scene(bpy.context, receivers=[linked, own])
    assert reading.targets == ("Own",)
    assert "another file" in reading.skipped[0][1]
    assert names_that_block(reading) == {"Linked", "Own"}


def test_scene_without_usable_mesh_says_what_to_do():
    with pytest.raises(EmptySceneError, match="no mesh that renders"):
        read_scene(bpy.context)
    link(bpy.data.objects.new("Nothing", bpy.data.meshes.new("Nothing")))
    with pytest.raises(EmptySceneError, match="Nothing has no faces"):
        read_scene(bpy.context)


def test_edit_mode_is_refused_by_name():
    obj = add_cube("Edited")
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode='EDIT')
    with pytest.raises(RadiosityError, match="'Edited' is in Edit Mode"):
        read_scene(bpy.context)
    bpy.ops.object.mode_set(mode='OBJECT')
    assert read_scene(bpy.context).targets == ("Edited",)


def test_object_hidden_from_all_rays_that_count_does_not_block():
    floor, ghost, half = (add_cube(name) for name in ("Floor", "Ghost", "Half"))
    ghost.visible_diffuse = ghost.visible_shadow = False
    half.visible_shadow = False
    reading = read_scene(bpy.context, receivers=[floor])
    assert names_that_block(reading) == {"Floor", "Half"}
    assert [text for text in reading.scene.warnings if "Half" in text and "Ghost" not in text]


def test_reading_twice_gives_the_same_bits():
    rng = np.random.default_rng(5)
    for i in range(20):
        add_cube(f"Cube{i}", rng.normal(size=3).tolist(), rng.normal(size=3).tolist())
    first, second = (read_scene(bpy.context).scene.surfaces for _ in range(2))
    for name in ("vertices", "triangles", "materials", "objects", "reflectance"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_ten_thousand_instances_are_all_there():
    """Each in its place: the sum over all vertices is that of the places."""
    floor = add_cube("Floor", mesh=cube_mesh(0.5))
    collection = bpy.data.collections.new("Many")
    inner = link(bpy.data.objects.new("Inner", cube_mesh(0.1)), collection)
    points = bpy.data.meshes.new("Points")
    places = np.random.default_rng(6).uniform(-50, 50, (10_000, 3))
    points.from_pydata(places.tolist(), [], [])
    parent = link(bpy.data.objects.new("Parent", points))
    link(inner)
    inner.parent = parent
    parent.instance_type = 'VERTS'
    bpy.context.view_layer.update()
    reading = read_scene(bpy.context, receivers=[floor])
    surfaces = reading.scene.surfaces
    assert len(surfaces.triangles) == 12 * 10_001
    assert reading.counts["objects"] == 10_001
    corners = surfaces.vertices[surfaces.triangles[surfaces.objects == list(surfaces.object_names).index("Inner")]]
    centers = corners.reshape(10_000, -1, 3)
    np.testing.assert_allclose(
        ((centers.min(1) + centers.max(1)) / 2)[np.lexsort(centers.mean(1).T)][:10],
        places[np.lexsort(places.T)][:10],
        atol=1e-4,
    )
