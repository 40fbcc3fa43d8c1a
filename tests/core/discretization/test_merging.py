"""Merged triangles are the same surface: same points covered, no cracks, few triangles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity.core.discretization.merging import merge_coplanar

UNIT = np.eye(3)


def grid(origin, along, across, columns, rows, hole=None):
    """Vertices and triangles of a divided parallelogram; `hole` is a function of cell centers in 0 to 1."""
    a, b = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1), indexing='ij')
    points = np.asarray(origin, float) + a[..., None] * np.asarray(along) + b[..., None] * np.asarray(across)
    index = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    cells = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    if hole is not None:
        center_a = (np.repeat(np.arange(columns), rows) + 0.5) / columns
        center_b = (np.tile(np.arange(rows), columns) + 0.5) / rows
        cells = cells[~hole(center_a, center_b)]
    return points.reshape(-1, 3), np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def join(parts):
    """One mesh from (vertices, triangles) parts that share no vertex rows, and a key for each part."""
    vertices, triangles, keys, base = [], [], [], 0
    for number, (points, faces) in enumerate(parts):
        vertices.append(points)
        triangles.append(faces + base)
        keys.append(np.full(len(faces), number))
        base += len(points)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32), np.concatenate(keys)


def box(divisions):
    """The unit cube from six divided squares, normals outward, no shared rows."""
    x, y, z = UNIT
    zero, one = np.zeros(3), np.ones(3)
    sides = [(zero, y, x), (zero, z, y), (zero, x, z), (one, -x, -y), (one, -y, -z), (one, -z, -x)]
    return join([grid(*side, divisions, divisions) for side in sides])


def area_vectors(vertices, triangles):
    corners = vertices[triangles]
    return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def covering(points, vertices, triangles):
    """How many triangles of a flat mesh (x, y) hold each point, by barycentric coordinates."""
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))

    def turn(p, q):
        return (q[None, :, 0] - p[None, :, 0]) * (points[:, None, 1] - p[None, :, 1]) - (
            q[None, :, 1] - p[None, :, 1]
        ) * (points[:, None, 0] - p[None, :, 0])

    return ((turn(a, b) > 0) & (turn(b, c) > 0) & (turn(c, a) > 0)).sum(axis=1)


def t_junctions(vertices, triangles):
    """Corners of triangles that lie inside an edge of another triangle (distance below 1e-9), by brute force."""
    corners = vertices[np.unique(triangles)]
    found = 0
    for k in range(3):
        start, stop = vertices[triangles[:, k]], vertices[triangles[:, (k + 1) % 3]]
        along = stop - start
        length = np.linalg.norm(along, axis=1)
        offset = corners[:, None, :] - start[None]
        share = (offset * along).sum(axis=2) / length**2
        height = np.linalg.norm(offset - share[..., None] * along, axis=2)
        found += int(((height < 1e-9) & (share * length > 1e-9) & ((1 - share) * length > 1e-9)).sum())
    return found


def assert_same_surface(vertices, triangles, keys, merged):
    """Per key and normal direction the area is the same, to rounding; sources have the key and the plane."""
    assert merged.vertices is vertices or np.shares_memory(merged.vertices, vertices)
    before, after = area_vectors(vertices, triangles), area_vectors(vertices, merged.triangles)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1).sum(), np.linalg.norm(before, axis=1).sum(), rtol=1e-9)
    for key in np.unique(keys):
        np.testing.assert_allclose(
            after[keys[merged.source] == key].sum(axis=0), before[keys == key].sum(axis=0), atol=1e-12, rtol=1e-9
        )
    turned = np.einsum('ij,ij->i', after, before[merged.source])
    sizes = np.linalg.norm(after, axis=1) * np.linalg.norm(before[merged.source], axis=1)
    np.testing.assert_allclose(turned, sizes, rtol=1e-9)
    height = np.einsum(
        'ij,ij->i', before[merged.source], vertices[merged.triangles[:, 0]] - vertices[triangles[merged.source, 0]]
    )
    assert np.abs(height / np.linalg.norm(before[merged.source], axis=1)).max() < 1e-9


@pytest.mark.parametrize('divisions', [2, 7, 40])
@pytest.mark.parametrize('same_key', [False, True])
def test_divided_box_becomes_twelve_triangles(divisions, same_key):
    vertices, triangles, keys = box(divisions)
    if same_key:
        keys = np.zeros_like(keys)
    merged = merge_coplanar(vertices, triangles, keys)
    assert len(merged.triangles) == 12
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0


def test_rounded_and_turned_box_becomes_twelve_triangles():
    vertices, triangles, keys = box(40)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    vertices = (vertices @ turn.T * 7 + 3).astype(np.float32).astype(np.float64)
    merged = merge_coplanar(vertices, triangles, keys)
    assert len(merged.triangles) == 12
    # float32 moves corners by 1e-6 m on edges of 7 m.
    area = np.linalg.norm(area_vectors(vertices, merged.triangles), axis=1).sum()
    np.testing.assert_allclose(area, 6 * 49, rtol=1e-6)


def test_floor_with_holes_keeps_its_holes():
    def hole(a, b):
        return ((abs(a - 0.25) < 0.1) & (abs(b - 0.3) < 0.1)) | ((abs(a - 0.7) < 0.15) & (abs(b - 0.6) < 0.2))

    vertices, triangles = grid((0, 0, 0), (4, 0, 0), (0, 3, 0), 40, 40, hole)
    keys = np.zeros(len(triangles), dtype=int)
    merged = merge_coplanar(vertices, triangles.astype(np.int32), keys)
    assert len(merged.triangles) == 12 + 2 * 2 - 2
    assert_same_surface(vertices, triangles, keys, merged)
    points = np.random.default_rng(0).uniform(0, 1, (2000, 2)) * (4, 3)
    assert np.array_equal(covering(points, vertices, merged.triangles), covering(points, vertices, triangles))


def test_holes_that_touch_at_a_corner():
    """Twelve visits of eleven corners around a square with two holes: Euler's formula leaves 12 triangles."""

    def hole(a, b):
        return (abs(a - 0.5) < 0.25) & (abs(b - 0.5) < 0.25) & ((a < 0.5) == (b < 0.5))

    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 8, 8, hole)
    keys = np.zeros(len(triangles), dtype=int)
    merged = merge_coplanar(vertices, triangles.astype(np.int32), keys)
    assert len(merged.triangles) == 12
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0


def test_l_shape_becomes_four_triangles():
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 30, 30, lambda a, b: (a > 0.4) & (b > 0.6))
    keys = np.zeros(len(triangles), dtype=int)
    merged = merge_coplanar(vertices, triangles.astype(np.int32), keys)
    assert len(merged.triangles) == 4
    assert_same_surface(vertices, triangles, keys, merged)


def test_corner_of_a_neighbor_stays_a_corner():
    """A floor of two halves in two materials, one of which is divided again: what the halves share must agree."""
    left = grid((0, 0, 0), (1, 0, 0), (0, 2, 0), 10, 20)
    lower = grid((1, 0, 0), (1, 0, 0), (0, 1, 0), 10, 10)
    upper = grid((1, 1, 0), (1, 0, 0), (0, 1, 0), 10, 10)
    vertices, triangles, keys = join([left, lower, upper])
    merged = merge_coplanar(vertices, triangles, keys)
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0
    assert len(merged.triangles) == 3 + 2 + 2


def test_neighbor_that_stays_divided_keeps_its_corners():
    flat, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 8, 8)
    bent, more = grid((1, 0, 0), (1, 0, 0), (0, 1, 0), 8, 8)
    bent[:, 2] = 0.3 * (bent[:, 0] - 1) ** 2 + 0.2 * (bent[:, 0] - 1) * np.sin(9 * bent[:, 1])
    vertices, triangles, keys = join([(flat, triangles), (bent, more)])
    merged = merge_coplanar(vertices, triangles, keys)
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0
    # The bent half is untouched; the flat half has the nine corners of the common edge and two more.
    assert (merged.source >= len(triangles) - len(more)).sum() == len(more)
    assert len(merged.triangles) == len(more) + 9


def test_partition_standing_on_a_floor_does_not_split_it():
    """Three faces at each edge of the wall's foot, vertices shared."""
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 10, 10)
    foot = np.arange(5 * 11, 6 * 11)
    top = np.arange(11) + len(vertices)
    vertices = np.concatenate([vertices, vertices[foot] + (0, 0, 1)])
    wall = np.stack([foot[:-1], foot[1:], top[1:], foot[:-1], top[1:], top[:-1]], axis=1).reshape(-1, 3)
    triangles = np.concatenate([triangles, wall]).astype(np.int32)
    keys = np.zeros(len(triangles), dtype=int)
    merged = merge_coplanar(vertices, triangles, keys)
    # The wall's two lower corners stay corners of the floor's border: six corners there, four triangles.
    assert len(merged.triangles) == 4 + 2
    assert t_junctions(vertices, merged.triangles) == 0
    assert_same_surface(vertices, triangles, keys, merged)


def test_curved_surface_is_left_alone():
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 60, 60)
    vertices[:, 2] = 0.3 * np.sin(3 * vertices[:, 0]) * np.cos(2 * vertices[:, 1])
    merged = merge_coplanar(vertices, triangles.astype(np.int32), np.zeros(len(triangles), int))
    assert np.array_equal(merged.triangles, triangles)
    assert np.array_equal(merged.source, np.arange(len(triangles)))


def test_small_relief_in_a_big_scene_keeps_its_shape():
    """A dent of a centimeter beside a ground of ten kilometers: below a millionth of the scene, but a shape."""
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 50, 50)
    vertices[:, 2] = 1e-2 * (vertices[:, 0] ** 2 + vertices[:, 1] ** 2)
    ground = grid((-5e3, -5e3, -1), (1e4, 0, 0), (0, 1e4, 0), 20, 20)
    vertices, triangles, keys = join([(vertices, triangles), ground])
    merged = merge_coplanar(vertices, triangles, keys)
    assert len(merged.triangles) == 5000 + 2


def test_opposite_faces_and_folds_are_not_merged():
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 6, 6)
    both = np.concatenate([triangles, triangles[:, ::-1]]).astype(np.int32)
    keys = np.zeros(len(both), dtype=int)
    merged = merge_coplanar(vertices, both, keys)
    assert len(merged.triangles) == 4
    assert_same_surface(vertices, both, keys, merged)


def test_degenerate_and_infinite_triangles_pass_through():
    vertices, triangles, _ = box(6)
    vertices = np.concatenate([vertices, [[np.nan, 0, 0], [np.inf, 0, 0], [0.3, 0.3, 0.0], [0.3, 0.3, 0.0]]])
    bad = np.array([[0, 1, len(vertices) - 4], [0, len(vertices) - 3, 2], [5, 5, 5], [0, 1, 2], [0, 248, 249]])
    triangles = np.concatenate([triangles, bad]).astype(np.int32)
    with np.errstate(all='raise'):
        merged = merge_coplanar(vertices, triangles, np.zeros(len(triangles), dtype=int))
    rows = {tuple(row) for row in merged.triangles.tolist()}
    assert {tuple(row) for row in bad.tolist()} <= rows
    assert len(merged.triangles) < len(triangles) / 4


@pytest.mark.parametrize('count', [0, 1, 2, 5])
def test_tiny_meshes(count):
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 3, 1)
    triangles = triangles[:count].astype(np.int32)
    merged = merge_coplanar(vertices, triangles, np.zeros(count, dtype=int))
    if count:
        assert_same_surface(vertices, triangles, np.zeros(count, int), merged)
    else:
        assert merged.triangles.shape == (0, 3)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="keys"):
        merge_coplanar(np.zeros((3, 3)), np.zeros((1, 3), int), np.zeros(2, int))
    with pytest.raises(ValueError, match="columns"):
        merge_coplanar(np.zeros((3, 2)), np.zeros((1, 3), int), np.zeros(1, int))


def test_result_does_not_depend_on_where_the_scene_is():
    vertices, triangles, keys = box(12)
    near = merge_coplanar(vertices, triangles, keys)
    far = merge_coplanar(vertices * 3.0 + 1000.0, triangles, keys)
    assert np.array_equal(near.triangles, far.triangles)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    columns=st.integers(1, 14),
    rows=st.integers(1, 14),
    materials=st.integers(1, 3),
    removed=st.floats(0.0, 0.6),
    split=st.booleans(),
    shuffle=st.booleans(),
)
def test_random_flat_mesh_covers_the_same_points(seed, columns, rows, materials, removed, split, shuffle):
    """Random holes, materials, diagonals, vertex splits and order: every point stays covered as often, per material.

    Touching corners, islands in holes and one-cell corridors all occur.
    """
    generator = np.random.default_rng(seed)
    vertices, triangles = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), columns, rows)
    cells = triangles.reshape(-1, 6)[:, [0, 1, 2, 5]]
    other = generator.random(len(cells)) < 0.5
    cells[other] = np.roll(cells[other], 1, axis=1)
    # Chunks of 2 x 2 cells share their fate, so that regions have a size worth merging.
    column, row = np.repeat(np.arange(columns), rows), np.tile(np.arange(rows), columns)
    chunk = (column // 2) * 100 + row // 2
    gone = generator.random(1400) < removed
    material = generator.integers(0, materials, 1400)
    cells, keys = cells[~gone[chunk]], material[chunk[~gone[chunk]]]
    triangles = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    keys = np.repeat(keys, 2)
    if len(triangles) == 0:
        return
    if split:
        loose = generator.random(len(triangles)) < 0.3
        extra = vertices[triangles[loose]].reshape(-1, 3)
        triangles[loose] = len(vertices) + np.arange(len(extra)).reshape(-1, 3)
        vertices = np.concatenate([vertices, extra])
    if shuffle:
        order = generator.permutation(len(triangles))
        triangles, keys = triangles[order], keys[order]
    merged = merge_coplanar(vertices, triangles.astype(np.int32), keys)
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0
    points = generator.uniform(0, 1, (300, 2))
    for key in range(materials):
        after = covering(points, vertices, merged.triangles[keys[merged.source] == key])
        assert np.array_equal(after, covering(points, vertices, triangles[keys == key]))
    again = merge_coplanar(vertices, triangles.astype(np.int32), keys)
    assert np.array_equal(again.triangles, merged.triangles)


def test_what_is_too_long_to_clip_keeps_its_triangles(monkeypatch):
    def hole(a, b):
        return (abs(a - 0.25) < 0.1) & (abs(b - 0.3) < 0.1)

    parts = [
        grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 20, 20, hole),
        grid((1, 0, 0), (1, 0, 0), (0, 1, 0), 20, 20),
        grid((0, 0, 1), (1, 0, 0), (0, 1, 0), 20, 20),
    ]
    vertices, triangles, keys = join(parts)
    assert len(merge_coplanar(vertices, triangles, keys).triangles) == 8 + 2 + 2
    monkeypatch.setattr('radiosity.core.discretization.merging.LARGEST_CLIPPING', 10.0)
    merged = merge_coplanar(vertices, triangles, keys)
    # The second square must keep the corners along the first, and is then no fan either; the third is.
    assert len(merged.triangles) == len(parts[0][1]) + len(parts[1][1]) + 2
    assert_same_surface(vertices, triangles, keys, merged)
    assert t_junctions(vertices, merged.triangles) == 0
