"""`radiosity.subdivide`: what is stored on a mesh survives, its shape and shading too, and what cannot is refused."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
import pytest


def make_object(name, vertices, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    return add_object(name, mesh)


def add_object(name, mesh):
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    return obj


def primitive(kind, **options):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
    return bpy.context.object


def read(items, name, columns=1, dtype=np.float32):
    values = np.empty(len(items) * columns, dtype=dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, columns) if columns > 1 else values


def positions(mesh):
    return read(mesh.vertices, "co", 3).astype(float)


def corner_positions(mesh):
    return positions(mesh)[read(mesh.loops, "vertex_index", dtype=np.int32)]


def edge_lengths(obj):
    world = positions(obj.data) @ np.array(obj.matrix_world.to_3x3()).T
    ends = read(obj.data.edges, "vertices", 2, np.int32)
    return np.linalg.norm(world[ends[:, 0]] - world[ends[:, 1]], axis=1)


def faces_per_edge(mesh):
    return np.bincount(read(mesh.loops, "edge_index", dtype=np.int32), minlength=len(mesh.edges))


def uv_area(mesh):
    """Sum over faces, by fans."""
    uv = read(mesh.uv_layers.active.uv, "vector", 2).astype(float)
    starts = read(mesh.polygons, "loop_start", dtype=np.int32)
    following = np.arange(1, len(uv) + 1)
    following[[*(starts[1:] - 1), len(uv) - 1]] = starts
    return 0.5 * np.abs(np.add.reduceat(uv[:, 0] * uv[following, 1] - uv[following, 0] * uv[:, 1], starts)).sum()


def snapshot(mesh):
    return (
        positions(mesh).tobytes(),
        read(mesh.loops, "vertex_index", dtype=np.int32).tobytes(),
        [(item.name, item.domain, item.data_type) for item in mesh.attributes],
    )


@pytest.mark.parametrize(
    'kind, options',
    [
        ('cube', {}),
        ('cylinder', {'vertices': 12}),
        ('cone', {'vertices': 7}),
        ('uv_sphere', {'segments': 12, 'ring_count': 6}),
        ('monkey', {}),
    ],
)
def test_short_edges_same_surface_no_gaps(kind, options):
    obj = primitive(kind, **options)
    obj.scale = (1.0, 2.0, 0.5)
    bpy.context.view_layer.update()
    mesh = obj.data
    area, old_uv_area = sum(face.area for face in mesh.polygons), uv_area(mesh)
    old_uses = sorted(set(faces_per_edge(mesh)))
    boundary = faces_per_edge(mesh) == 1
    rim = edge_lengths(obj)[boundary].sum()
    assert bpy.ops.radiosity.subdivide(max_edge_length=0.15) == {'FINISHED'}
    assert not mesh.validate()
    assert edge_lengths(obj).max() <= 0.15 * (1 + 1.1e-4)
    assert sorted(set(faces_per_edge(mesh))) == old_uses
    assert edge_lengths(obj)[faces_per_edge(mesh) == 1].sum() == pytest.approx(rim, rel=1e-5)
    # Bent quadrilaterals become bilinear patches, whose area is a little less than that of two triangles.
    assert sum(face.area for face in mesh.polygons) == pytest.approx(area, rel=1e-5 if kind != 'monkey' else 1e-2)
    assert uv_area(mesh) == pytest.approx(old_uv_area, rel=1e-4)
    if kind != 'monkey':  # whose eyes touch the head
        assert len({tuple(np.round(co, 6)) for co in positions(mesh)}) == len(mesh.vertices)


def test_second_run_changes_nothing():
    obj = primitive('monkey')
    bpy.ops.radiosity.subdivide(max_edge_length=0.1)
    before = snapshot(obj.data)
    assert bpy.ops.radiosity.subdivide(max_edge_length=0.1) == {'CANCELLED'}
    assert snapshot(obj.data) == before


def test_attributes_of_all_kinds_are_carried_over():
    """Linear functions of position stay what they were; the rest is inherited."""
    obj = make_object("L", [(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)], [(0, 1, 2, 3, 4, 5)])
    mesh = obj.data
    for domain, count in (('POINT', len(mesh.vertices)), ('CORNER', len(mesh.loops))):
        where = positions(mesh) if domain == 'POINT' else corner_positions(mesh)
        for data_type, name, columns in (
            ('FLOAT', "value", 1),
            ('FLOAT2', "vector", 2),
            ('FLOAT_VECTOR', "vector", 3),
            ('FLOAT_COLOR', "color", 4),
            ('BYTE_COLOR', "color", 4),
        ):
            attribute = mesh.attributes.new(f"{domain}{data_type}", data_type, domain)
            values = 0.1 + 0.3 * np.resize(where[:, :2], (count, 2)) @ np.array([[1, 0, 1, 0.5], [0, 1, 1, 1]])
            attribute.data.foreach_set(name, values[:, :columns].astype(np.float32).ravel())
        mesh.attributes.new(f"{domain}INT", 'INT', domain).data.foreach_set("value", np.arange(count) + 5)
    text = mesh.attributes.new("face text", 'STRING', 'FACE').data[0]
    floor = b"floor" if isinstance(text.value, bytes) else "floor"
    text.value = floor
    mesh.attributes.new("face number", 'INT8', 'FACE').data[0].value = 7
    mesh.attributes.active_color_name = "POINTFLOAT_COLOR"
    mesh.attributes.default_color_name = "CORNERBYTE_COLOR"
    names = {item.name for item in mesh.attributes}
    bpy.ops.radiosity.subdivide(max_edge_length=0.3)
    assert names <= {item.name for item in mesh.attributes}
    assert mesh.attributes.active_color_name == "POINTFLOAT_COLOR"
    assert mesh.attributes.default_color_name == "CORNERBYTE_COLOR"
    for domain in ('POINT', 'CORNER'):
        where = positions(mesh) if domain == 'POINT' else corner_positions(mesh)
        expected = 0.1 + 0.3 * where[:, :2] @ np.array([[1, 0, 1, 0.5], [0, 1, 1, 1]])
        for data_type, name, columns in (
            ('FLOAT', "value", 1),
            ('FLOAT2', "vector", 2),
            ('FLOAT_VECTOR', "vector", 3),
            ('FLOAT_COLOR', "color", 4),
        ):
            attribute = mesh.attributes[f"{domain}{data_type}"]
            assert (attribute.domain, attribute.data_type) == (domain, data_type)
            values = read(attribute.data, name, columns).reshape(len(where), -1)
            np.testing.assert_allclose(values, expected[:, :columns], atol=1e-6)
        numbers = read(mesh.attributes[f"{domain}INT"].data, "value", dtype=np.int32)
        assert set(numbers) == set(range(5, 11))
    assert {item.value for item in mesh.attributes["face text"].data} == {floor}
    assert (read(mesh.attributes["face number"].data, "value", dtype=np.int32) == 7).all()


def test_byte_colors_are_interpolated_in_linear_light():
    obj = make_object("Floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    layer = obj.data.attributes.new("Bytes", 'BYTE_COLOR', 'POINT')
    layer.data.foreach_set("color", np.repeat([0.1, 0.9, 0.9, 0.1], 4).astype(np.float32))
    bpy.ops.radiosity.subdivide(max_edge_length=0.125)
    values = read(obj.data.attributes["Bytes"].data, "color", 4)[:, 0]
    # Half a byte of sRGB at the ends and in between: 0.0046 of linear light each.
    np.testing.assert_allclose(values, 0.1 + 0.8 * positions(obj.data)[:, 0], atol=0.0092)


def test_edge_and_face_marks_are_inherited():
    obj = primitive('cube')
    mesh = obj.data
    mesh.materials.append(bpy.data.materials.new("A"))
    mesh.materials.append(bpy.data.materials.new("B"))
    mesh.polygons[2].material_index = 1
    mesh.polygons[3].use_smooth = True
    mesh.edges[11].use_seam = True  # the last: what is missing must not be read from the end
    mesh.edges[2].use_edge_sharp = True
    mesh.edge_creases_ensure()
    mesh.edge_creases.data[4].value = 0.5
    mesh.vertex_creases_ensure()
    mesh.vertex_creases.data[3].value = 0.75
    old = positions(mesh)
    ends = read(mesh.edges, "vertices", 2, np.int32)
    areas = [mesh.polygons[2].area, mesh.polygons[3].area]
    bpy.ops.radiosity.subdivide(max_edge_length=0.25)
    new = positions(mesh)
    middles = new[read(mesh.edges, "vertices", 2, np.int32)].mean(axis=1)

    def pieces_of(edge):
        start, stop = old[ends[edge]]
        share = (middles - start) @ (stop - start) / ((stop - start) @ (stop - start))
        return np.linalg.norm(middles - start - share[:, None] * (stop - start), axis=1) < 1e-6

    assert np.array_equal(read(mesh.edges, "use_seam", dtype=bool), pieces_of(11))
    assert np.array_equal(read(mesh.edges, "use_edge_sharp", dtype=bool), pieces_of(2))
    np.testing.assert_array_equal(read(mesh.edge_creases.data, "value"), np.where(pieces_of(4), 0.5, 0.0))
    creases = read(mesh.vertex_creases.data, "value")
    assert creases[3] == 0.75 and np.count_nonzero(creases) == 1
    assert sum(face.area for face in mesh.polygons if face.material_index == 1) == pytest.approx(areas[0])
    assert sum(face.area for face in mesh.polygons if face.use_smooth) == pytest.approx(areas[1])


def test_vertex_groups_are_linear():
    obj = make_object("Floor", [(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    first, second = obj.vertex_groups.new(name="Pin"), obj.vertex_groups.new(name="Radiosity Ünïcode")
    for index, weight in enumerate((0.25, 0.75, 1.0, 0.5)):
        first.add([index], weight, 'REPLACE')
    second.add([1], 1.0, 'REPLACE')
    second.lock_weight = True
    obj.vertex_groups.new(name="Empty")
    obj.vertex_groups.active_index = 1
    objects, scenes, nodes = (len(items) for items in (bpy.data.objects, bpy.data.scenes, bpy.data.node_groups))
    bpy.ops.radiosity.subdivide(max_edge_length=0.25)
    place = positions(obj.data)
    u, v = place[:, 0] / 2, place[:, 1]
    expected = np.stack([0.25 + 0.5 * u + 0.25 * v, u * (1 - v)], axis=1)
    weights = np.zeros((len(place), 3))
    for vertex in obj.data.vertices:
        for member in vertex.groups:
            weights[vertex.index, member.group] = member.weight
    np.testing.assert_allclose(weights[:, :2], expected, atol=1e-6)
    assert not weights[:, 2].any()
    assert [group.name for group in obj.vertex_groups] == ["Pin", "Radiosity Ünïcode", "Empty"]
    assert obj.vertex_groups[1].lock_weight and obj.vertex_groups.active_index == 1
    assert not any("radiosity" in item.name for item in obj.data.attributes)
    assert (objects, scenes, nodes) == tuple(
        len(items) for items in (bpy.data.objects, bpy.data.scenes, bpy.data.node_groups)
    )


@pytest.mark.parametrize('custom', [False, True])
def test_smooth_shading_looks_the_same(custom):
    """Normals of a smooth tube vary linearly around each face, as they were drawn before."""
    obj = primitive('cylinder', vertices=12, end_fill_type='NOTHING')
    bpy.ops.object.shade_smooth()
    mesh = obj.data
    mesh.edges[0].use_edge_sharp = True
    if custom:
        normals = read(mesh.corner_normals, "vector", 3).astype(float) + np.array([0, 0, 0.3])
        mesh.normals_split_custom_set((normals / np.linalg.norm(normals, axis=1)[:, None]).tolist())
    sharp = edge_lengths(obj)[read(mesh.edges, "use_edge_sharp", dtype=bool)].sum()
    old_normals, old_corners = read(mesh.corner_normals, "vector", 3), corner_positions(mesh)
    old_centers = old_corners.reshape(-1, 4, 3).mean(axis=1)
    bpy.ops.radiosity.subdivide(max_edge_length=0.2)
    assert mesh.has_custom_normals
    where, normals = corner_positions(mesh), read(mesh.corner_normals, "vector", 3)
    corner_faces = np.repeat(np.arange(len(mesh.polygons)), read(mesh.polygons, "loop_total", dtype=np.int32))
    centers = read(mesh.polygons, "center", 3).astype(float)
    # The side each new face lies on, by the azimuth of its center.
    azimuth, old_azimuth = (np.arctan2(points[:, 1], points[:, 0]) for points in (centers, old_centers))
    apart = np.abs(np.angle(np.exp(1j * (azimuth[:, None] - old_azimuth))))
    side = apart.argmin(axis=1)[corner_faces]
    corners, values = old_corners.reshape(-1, 4, 3)[side], old_normals.reshape(-1, 4, 3)[side]
    along, across = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    s = ((where - corners[:, 0]) * along).sum(axis=1) / (along**2).sum(axis=1)
    t = ((where - corners[:, 0]) * across).sum(axis=1) / (across**2).sum(axis=1)
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=1)
    expected = np.einsum('nk,nki->ni', weights, values)
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    # Blender stores custom normals as two 16-bit angles: 1e-4; the rest of the allowance is the float32 of positions.
    assert np.abs(normals - expected).max() < 1e-3
    assert edge_lengths(obj)[read(mesh.edges, "use_edge_sharp", dtype=bool)].sum() == pytest.approx(sharp, rel=1e-5)


def test_flat_shading_needs_no_custom_normals():
    obj = primitive('cylinder', vertices=12)
    bpy.ops.radiosity.subdivide(max_edge_length=0.2)
    assert not obj.data.has_custom_normals


def test_loose_parts_stay():
    obj = make_object("Floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)])
    edit = bmesh.new()
    edit.from_mesh(obj.data)
    edit.edges.new((edit.verts.new((5, 0, 0)), edit.verts.new((9, 0, 0))))
    edit.verts.new((7, 7, 7))
    edit.to_mesh(obj.data)
    edit.free()
    bpy.ops.radiosity.subdivide(max_edge_length=0.25)
    assert len(obj.data.vertices) == 25 + 3
    assert edge_lengths(obj).max() == pytest.approx(4.0)


def test_modifiers_stay_and_the_base_mesh_is_divided():
    obj = primitive('cube')
    obj.modifiers.new("Bevel", 'BEVEL')
    bpy.ops.radiosity.subdivide(max_edge_length=0.5)
    assert [modifier.name for modifier in obj.modifiers] == ["Bevel"]
    assert len(obj.data.polygons) == 6 * 16


def test_undo_is_one_step():
    obj = primitive('cube')
    bpy.ops.ed.undo_push(message="before")
    before = snapshot(obj.data)
    bpy.ops.radiosity.subdivide(max_edge_length=0.5)
    bpy.ops.ed.undo_push(message="Subdivide")  # scripts push no steps of their own; the interface does
    assert len(bpy.data.objects["Cube"].data.vertices) > 8
    bpy.ops.ed.undo()
    assert snapshot(bpy.data.objects["Cube"].data) == before


def test_limit_is_refused_with_numbers_and_nothing_changes():
    obj = primitive('cube')
    before = snapshot(obj.data)
    with pytest.raises(RuntimeError, match=r"make 26,936 vertices.*limit of 1,000: use 0\.\d+ m \(\d+ vertices\)"):
        bpy.ops.radiosity.subdivide(max_edge_length=0.03, limit=1000)
    assert snapshot(obj.data) == before
    with pytest.raises(RuntimeError, match=r"make about 24,000,000 vertices.*use 0\.0\d+ m \(\d{2},\d{3} vertices\)"):
        bpy.ops.radiosity.subdivide(max_edge_length=0.001, limit=20_000)
    assert snapshot(obj.data) == before
    bpy.context.scene.radiosity.subdivide_limit = 500
    with pytest.raises(RuntimeError, match="limit of 500"):
        bpy.ops.radiosity.subdivide(max_edge_length=0.05)
    bpy.context.scene.radiosity.subdivide_limit = 4
    with pytest.raises(RuntimeError, match="have 8 vertices already"):
        bpy.ops.radiosity.subdivide(max_edge_length=0.05)


def test_limit_counts_all_selected_meshes_together():
    primitive('cube')
    alone = {'max_edge_length': 0.2, 'limit': 700}
    primitive('cube', location=(5, 0, 0))
    bpy.ops.object.select_all(action='SELECT')
    with pytest.raises(RuntimeError, match="limit of 700"):
        bpy.ops.radiosity.subdivide(**alone)
    bpy.ops.object.select_all(action='DESELECT')
    bpy.context.object.select_set(True)
    assert bpy.ops.radiosity.subdivide(**alone) == {'FINISHED'}
    assert len(bpy.context.object.data.vertices) == 602


def test_length_comes_from_the_scene_or_is_proposed():
    obj = primitive('cube')
    bpy.ops.radiosity.subdivide()
    assert 12_000 < len(obj.data.vertices) <= 20_000
    bpy.context.scene.radiosity.subdivide_length = 0.5
    obj = primitive('cube', location=(5, 0, 0))
    bpy.ops.object.select_all(action='DESELECT')
    obj.select_set(True)
    bpy.ops.radiosity.subdivide()
    assert len(obj.data.vertices) == 98


def refused(match):
    objects = [obj for obj in bpy.context.scene.objects if obj.type == 'MESH']
    before = [snapshot(obj.data) for obj in objects]
    with pytest.raises(RuntimeError, match=match):
        bpy.ops.radiosity.subdivide(max_edge_length=0.1)
    assert [snapshot(obj.data) for obj in objects] == before


def test_unfit_meshes_are_refused_by_name():
    fit = primitive('cube')
    keyed = primitive('cube', location=(5, 0, 0))
    keyed.name = "Face"
    keyed.shape_key_add(name="Basis")
    fit.select_set(True)
    refused('"Face" has shape keys')
    keyed.shape_key_clear()
    keyed.modifiers.new("Multires", 'MULTIRES')
    refused('"Face" has a Multires modifier')


def test_shared_mesh_is_divided_once_or_refused_by_name():
    first = primitive('cube')
    second = add_object("Twin", first.data)
    second.select_set(False)
    refused('"Twin" shares the mesh of "Cube"')
    second.select_set(True)
    second.scale = (2, 2, 2)
    bpy.context.view_layer.update()
    refused("different scales")
    second.scale, second.rotation_euler = (1, 1, 1), (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    bpy.ops.radiosity.subdivide(max_edge_length=0.5)
    assert first.data is second.data
    assert len(first.data.polygons) == 6 * 16


def test_nothing_to_divide_without_faces():
    make_object("Dots", [(0, 0, 0), (1, 0, 0)], [])
    refused('"Dots" has no faces')
