"""Divided faces: short enough, conforming, the same surface, and linear things stay linear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity.core.discretization.subdivision import (
    SLACK,
    PolygonMesh,
    fitting_edge_length,
    predict_all,
    predict_subdivision,
    proposed_edge_length,
    subdivide,
)


def polygon_mesh(positions, faces, triangulations=None):
    """A mesh from lists of vertices; faces are fanned from their first corner unless a triangulation is given."""
    positions = np.asarray(positions, dtype=float)
    offsets = np.concatenate([[0], np.cumsum([len(face) for face in faces])])
    corners = np.concatenate([np.asarray(face) for face in faces])
    pairs = np.concatenate([np.stack([face, np.roll(face, -1)], axis=1) for face in faces])
    edges, corner_edges = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
    triangles, owners = [], []
    for number, face in enumerate(faces):
        local = (triangulations or {}).get(number) or [(0, k, k + 1) for k in range(1, len(face) - 1)]
        triangles += [[offsets[number] + k for k in triangle] for triangle in local]
        owners += [number] * len(local)
    return PolygonMesh(positions, edges, offsets, corners, corner_edges.ravel(), np.array(triangles), np.array(owners))


def as_mesh(mesh, result):
    positions = new_positions(mesh, result)
    faces = np.split(result.corner_vertices, result.face_offsets[1:-1])
    return polygon_mesh(positions, faces)


def new_positions(mesh, result):
    return np.einsum('nk,nki->ni', result.vertex_weights, mesh.positions[result.vertex_sources])


def edge_lengths(positions, edges):
    return np.linalg.norm(positions[edges[:, 0]] - positions[edges[:, 1]], axis=1)


def face_areas(positions, offsets, corners):
    """Area vectors by fans, exact for planar polygons of any shape."""
    first = positions[corners[offsets[:-1]]]
    relative = positions[corners] - np.repeat(first, np.diff(offsets), axis=0)
    following = np.arange(1, len(corners) + 1)
    following[offsets[1:] - 1] = offsets[:-1]
    return 0.5 * np.add.reduceat(np.cross(relative, relative[following]), offsets[:-1])


def check(mesh, length, result):
    """Everything that holds for any division."""
    positions = new_positions(mesh, result)
    count = len(mesh.positions)
    assert np.array_equal(positions[:count], mesh.positions)
    assert np.array_equal(result.vertex_sources[:count, 0], np.arange(count))
    np.testing.assert_allclose(result.vertex_weights.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(result.corner_weights.sum(axis=1), 1.0, rtol=1e-12)
    assert result.corner_weights.min() >= 0
    # Each vertex is used, and the corners' own weights lead to the same place: attributes follow the surface.
    assert len(np.unique(result.corner_vertices)) == len(positions)
    by_corner = np.einsum(
        'nk,nki->ni', result.corner_weights, mesh.positions[mesh.corner_vertices[result.corner_sources]]
    )
    np.testing.assert_allclose(by_corner, positions[result.corner_vertices], atol=1e-12 * np.abs(mesh.positions).max())
    # No edge is too long, in grids, transitions and along old edges alike.
    assert edge_lengths(positions, result.edges).max() <= length * (1 + SLACK) * (1 + 1e-12)
    # No T-vertices: every new edge has as many faces as the old edge it is part of, and two inside of faces.
    new_uses = np.bincount(result.corner_edges, minlength=len(result.edges))
    old_uses = np.bincount(mesh.corner_edges, minlength=len(mesh.edges))
    inside = result.edge_sources < 0
    assert (new_uses[inside] == 2).all()
    assert np.array_equal(new_uses[~inside], old_uses[result.edge_sources[~inside]])
    # The edges of the corners are theirs.
    following = np.arange(1, len(result.corner_vertices) + 1)
    following[result.face_offsets[1:] - 1] = result.face_offsets[:-1]
    pairs = np.stack([result.corner_vertices, result.corner_vertices[following]], axis=1)
    assert np.array_equal(np.sort(pairs, axis=1), np.sort(result.edges[result.corner_edges], axis=1))
    # Old edges keep their length, in pieces.
    lengths = np.bincount(result.edge_sources[~inside], weights=edge_lengths(positions, result.edges[~inside]))
    np.testing.assert_allclose(lengths, edge_lengths(mesh.positions, mesh.edges), rtol=1e-12)
    # Old faces keep their area vector, in pieces that all face the same way.
    areas = face_areas(positions, result.face_offsets, result.corner_vertices)
    old_areas = face_areas(mesh.positions, mesh.face_offsets, mesh.corner_vertices)
    for axis in range(3):
        sums = np.bincount(result.face_sources, weights=areas[:, axis], minlength=len(old_areas))
        np.testing.assert_allclose(sums, old_areas[:, axis], atol=1e-12 * np.abs(old_areas).max())
    assert (np.einsum('ij,ij->i', areas, old_areas[result.face_sources]) > 0).all()
    assert predict_subdivision(mesh, length) == (len(positions), len(areas))


def test_rectangle_becomes_a_grid_of_the_least_number():
    mesh = polygon_mesh([(0, 0, 0), (3, 0, 0), (3, 1.7, 0), (0, 1.7, 0)], [(0, 1, 2, 3)])
    result = subdivide(mesh, 0.1)
    check(mesh, 0.1, result)
    assert len(result.face_sources) == 30 * 17
    assert (np.diff(result.face_offsets) == 4).all()
    areas = face_areas(new_positions(mesh, result), result.face_offsets, result.corner_vertices)
    np.testing.assert_allclose(areas[:, 2], 0.01, rtol=1e-12)


def test_long_thin_face_is_cut_lengthwise_only():
    mesh = polygon_mesh([(0, 0, 0), (3, 0, 0), (3, 0.05, 0), (0, 0.05, 0)], [(0, 1, 2, 3)])
    assert len(subdivide(mesh, 0.1).face_sources) == 30


def test_equilateral_triangle_becomes_a_regular_grid():
    mesh = polygon_mesh([(0, 0, 0), (1, 0, 0), (0.5, np.sqrt(0.75), 0)], [(0, 1, 2)])
    result = subdivide(mesh, 0.1)
    check(mesh, 0.1, result)
    areas = face_areas(new_positions(mesh, result), result.face_offsets, result.corner_vertices)
    np.testing.assert_allclose(areas[:, 2], np.sqrt(0.75) / 200, rtol=1e-12)


@pytest.mark.parametrize('length', [0.05, 0.3, 0.7])
def test_concave_face_keeps_its_shape(length):
    outline = [(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)]
    mesh = polygon_mesh(outline, [(0, 1, 2, 3, 4, 5)], {0: [(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)]})
    result = subdivide(mesh, length)
    check(mesh, length, result)
    centers = np.add.reduceat(new_positions(mesh, result)[result.corner_vertices], result.face_offsets[:-1])
    centers /= np.diff(result.face_offsets)[:, None]
    assert not ((centers[:, 0] > 1) & (centers[:, 1] > 1)).any()


def test_concave_quadrilateral_keeps_its_shape():
    mesh = polygon_mesh([(0, 0, 0), (2, 1, 0), (0, 2, 0), (0.5, 1, 0)], [(0, 1, 2, 3)], {0: [(0, 1, 3), (1, 2, 3)]})
    check(mesh, 0.2, subdivide(mesh, 0.2))


def test_short_faces_are_left_alone_whatever_their_corners():
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    positions = np.concatenate([ring, ring * (1, 1, 0) + (0, 0, 9)])
    faces = [tuple(range(8)), *[(k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8) for k in range(8)]]
    mesh = polygon_mesh(positions, faces)
    result = subdivide(mesh, 1.2)
    check(mesh, 1.2, result)
    assert np.diff(result.face_offsets)[0] == 8
    assert len(result.face_sources) == 1 + 8 * 8


def test_wide_face_with_short_edges_is_divided_inside():
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    mesh = polygon_mesh(np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1), [tuple(range(64))])
    result = subdivide(mesh, 0.1)
    check(mesh, 0.1, result)
    assert len(result.vertex_sources) > 64 + np.pi / 0.01 * 0.5


def test_second_run_finds_nothing_to_do():
    generator = np.random.default_rng(5)
    mesh = random_mesh(generator, 3, 4, bend=0.2)
    result = subdivide(mesh, 0.11)
    rounded = as_mesh(mesh, result)
    rounded.positions[:] = rounded.positions.astype(np.float32)
    assert subdivide(rounded, 0.11) is None
    assert predict_subdivision(rounded, 0.11) == (len(rounded.positions), len(rounded.face_offsets) - 1)


def test_vertices_that_are_not_finite_are_not_cut():
    mesh = polygon_mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, np.nan, 0), (np.inf, 0, 0)], [(0, 1, 2, 3), (0, 4, 1)])
    result = subdivide(mesh, 0.1)
    counts = np.bincount(result.edge_sources[result.edge_sources >= 0])
    finite = np.isfinite(mesh.positions[mesh.edges]).all(axis=(1, 2))
    assert (counts[finite] == 10).all()
    assert (counts[~finite] == 1).all()


@pytest.mark.parametrize('length', [0.0, -1.0, np.nan])
def test_length_must_be_positive(length):
    mesh = polygon_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    with pytest.raises(ValueError, match="above 0"):
        subdivide(mesh, length)


def random_mesh(generator, columns, rows, bend=0.0):
    """A net of quadrilaterals of uneven size, some split into triangles, some joined to six corners."""
    x = np.concatenate([[0], np.cumsum(generator.uniform(0.1, 1.0, columns))])
    y = np.concatenate([[0], np.cumsum(generator.uniform(0.1, 1.0, rows))])
    positions = np.stack([*np.meshgrid(x, y, indexing='ij'), np.zeros((columns + 1, rows + 1))], axis=-1).reshape(-1, 3)
    positions[:, :2] += generator.uniform(-0.02, 0.02, (len(positions), 2))
    positions[:, 2] = bend * np.sin(positions[:, 0])
    faces, index = [], np.arange(len(positions)).reshape(columns + 1, rows + 1)
    for i in range(columns):
        j = 0
        while j < rows:
            a, b, c, d = index[i, j], index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]
            kind = generator.integers(4)
            if kind == 0:
                faces += [(a, b, c), (a, c, d)]
            elif kind == 1 and j + 1 < rows and bend == 0.0:
                faces.append((a, b, c, index[i + 1, j + 2], index[i, j + 2], d))
                j += 1
            else:
                faces.append((a, b, c, d))
            j += 1
    # Six corners are nearly a rectangle, but with two corners in the middle of straight sides: no fan fits.
    six = [(0, 1, 2), (0, 2, 5), (5, 2, 3), (5, 3, 4)]
    return polygon_mesh(positions, faces, {k: six for k, face in enumerate(faces) if len(face) == 6})


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    columns=st.integers(1, 4),
    rows=st.integers(1, 4),
    length=st.floats(0.07, 1.5),
    scale=st.sampled_from([1e-4, 1.0, 1e4]),
)
def test_random_net(seed, columns, rows, length, scale):
    mesh = random_mesh(np.random.default_rng(seed), columns, rows)
    mesh.positions[:] *= scale
    result = subdivide(mesh, length * scale)
    if result is None:
        assert edge_lengths(mesh.positions, mesh.edges).max() <= length * scale * (1 + SLACK)
        return
    check(mesh, length * scale, result)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), corners=st.sampled_from([3, 4]), stretch=st.floats(0.05, 1.0))
def test_random_triangle_and_quadrilateral(seed, corners, stretch):
    """Any proportions, in any position in space; for four corners on a circle, which is convex."""
    generator = np.random.default_rng(seed)
    angles = np.sort(generator.uniform(0, 2 * np.pi, corners))
    if np.diff(angles).min() < 0.05 or angles[-1] - angles[0] > 2 * np.pi - 0.05:
        return
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    positions = np.stack([np.cos(angles), stretch * np.sin(angles), 0 * angles], axis=1) @ turn
    mesh = polygon_mesh(positions, [tuple(range(corners))])
    result = subdivide(mesh, 0.07)
    if result is not None:
        check(mesh, 0.07, result)


def test_prediction_stops_at_the_limit():
    mesh = random_mesh(np.random.default_rng(3), 4, 4)
    vertices, faces = predict_subdivision(mesh, 0.05)
    assert predict_subdivision(mesh, 0.05, limit=vertices) == (vertices, faces)
    assert predict_subdivision(mesh, 0.05, limit=vertices - 1) is None
    assert predict_subdivision(mesh, 1e-9, limit=10**6) is None
    assert predict_all([mesh, mesh], 0.05, limit=2 * vertices) == (2 * vertices, 2 * faces)
    assert predict_all([mesh, mesh], 0.05, limit=2 * vertices - 1) is None


def test_fitting_length_is_the_smallest_that_fits():
    meshes = [random_mesh(np.random.default_rng(seed), 3, 3) for seed in range(3)]
    length = fitting_edge_length(meshes, 5000, start=0.01)
    assert predict_all(meshes, length, 5000) is not None
    assert predict_all(meshes, length / 1.3, 5000) is None
    assert fitting_edge_length(meshes, 10) == float('inf')


@pytest.mark.parametrize('scale', [1e-3, 1.0, 1e3])
def test_proposed_length_gives_about_the_wished_number(scale):
    meshes = [random_mesh(np.random.default_rng(seed), 3, 3) for seed in range(3)]
    for mesh in meshes:
        mesh.positions[:] *= scale
    length = proposed_edge_length(meshes, 20_000)
    assert 12_000 < predict_all(meshes, length)[0] <= 20_000
    assert float(f"{length:.1e}") == pytest.approx(length, rel=1e-9)


def test_no_length_is_proposed_without_area():
    assert proposed_edge_length([]) == 0.0
