"""Receivers: one per vertex and smooth group, shared across seams, moved off borders, none where nothing is finite."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.gathering.placing import place_receivers
from radiosity.core.gathering.receivers import INSET, build_receivers
from radiosity.core.visibility.embree import OFFSET, Frame, RayPool, Tracer

from tests.bakes import Thing, receiver_of, scene_of
from tests.scenes import box, cornell_box, grid, inward_sphere, joined

UNIT = Frame(np.zeros(3), 1.0)
SQUARE = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]


def cube(divisions=1):
    vertices, faces, _ = box(divisions=divisions)
    # One mesh with shared vertices, flat faces.
    _, first, inverse = np.unique(np.round(vertices, 9), axis=0, return_index=True, return_inverse=True)
    return receiver_of(Thing(vertices[first] - 0.5, inverse.reshape(-1)[faces]))


def unwelded(mesh):
    return replace(
        mesh,
        positions=mesh.positions[mesh.corner_vertices],
        corner_vertices=np.arange(len(mesh.corner_vertices), dtype=np.int32),
    )


@pytest.mark.parametrize("divisions", [1, 2, 5])
def test_sharp_edges_have_a_receiver_on_each_side(divisions):
    mesh = cube(divisions)
    receivers = build_receivers([mesh], UNIT)
    assert len(mesh.positions) == 6 * divisions**2 + 2
    assert len(receivers) == 6 * (divisions + 1) ** 2
    rows = receivers.corner_receivers[0]
    np.testing.assert_allclose(receivers.normals[rows], mesh.corner_normals, atol=1e-6)
    # Edges join receivers of one side only: those of the six grids.
    assert len(receivers.edges) == 6 * 2 * divisions * (divisions + 1)
    one, other = receivers.normals[receivers.edges].transpose(1, 0, 2)
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_smooth_mesh_has_one_receiver_per_vertex_in_its_place():
    scene = inward_sphere(8)
    mesh = scene.receivers[0]
    receivers = build_receivers([mesh], Frame.around(mesh.positions))
    assert len(receivers) == len(mesh.positions)
    # Where faces are uneven a vertex may count as a border, and moves by a thousandth of them.
    np.testing.assert_allclose(
        receivers.points[receivers.corner_receivers[0]], mesh.positions[mesh.corner_vertices] / 2, atol=1e-4
    )


def test_closed_smooth_mesh_has_no_border():
    mesh = inward_sphere(8).receivers[0]
    assert not build_receivers([mesh], Frame.around(mesh.positions)).borders.any()


@pytest.mark.parametrize("mesh", [cube(3), inward_sphere(4).receivers[0]], ids=["cube", "sphere"])
def test_split_vertices_share_receivers(mesh):
    whole, split = build_receivers([mesh], UNIT), build_receivers([unwelded(mesh)], UNIT)
    assert len(split) == len(whole)
    np.testing.assert_array_equal(split.corner_receivers[0], whole.corner_receivers[0])
    np.testing.assert_allclose(split.points, whole.points, atol=1e-3 * whole.sizes.max())
    order = np.lexsort(split.edges.T)
    np.testing.assert_array_equal(split.edges[order], whole.edges[np.lexsort(whole.edges.T)])


def test_touching_objects_share_receivers_at_their_seam():
    left = receiver_of(Thing(*grid([(-1, 0, 0), (0, 0, 0), (0, 1, 0), (-1, 1, 0)], 4, 4)))
    right = receiver_of(Thing(*grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4)))
    receivers = build_receivers([left, right], UNIT)
    assert len(receivers) == 2 * 25 - 5
    seam = np.abs(receivers.points[:, 0]) < 1e-6
    assert not receivers.borders[seam & (np.abs(receivers.points[:, 1] - 0.5) < 0.4)].any(), "a seam is no border"


def test_rooms_that_meet_at_a_point_have_a_receiver_each():
    corners = [(0, 0), (-1, 0), (-1, -1), (0, -1)]
    floors = [receiver_of(Thing(*grid(SQUARE + np.array([x + 0.5, y + 0.5, 0]), 2, 2))) for x, y in corners]

    def parts(places, others):
        """Walls along both axes."""
        return (np.sign(places[:, :2]) != np.sign(others[:, :2])).any(axis=1)

    together, parted = build_receivers(floors, UNIT), build_receivers(floors, UNIT, parts)
    assert len(together) == 25
    assert len(parted) == 36
    for number, (x, y) in enumerate(corners):
        mine = parted.points[parted.corner_receivers[number]]
        assert ((mine[:, 0] > 0) == (x == 0)).all() and ((mine[:, 1] > 0) == (y == 0)).all()
    # Walls along one axis only: the rooms on either side keep what they share.
    halves = build_receivers(floors, UNIT, lambda a, b: np.sign(a[:, 0]) != np.sign(b[:, 0]))
    assert len(halves) == 2 * 15


def test_a_smooth_ridge_of_split_faces_is_no_wall():
    """Faces fall away from a vertex they share: the way over it is free."""
    slope = np.tan(np.radians(40))
    left = np.array([(-1, 0, -slope), (0, 0, 0), (0, 1, 0), (-1, 1, -slope)])
    roof = [left, (left * (-1, 1, 1))[::-1]]
    vertices, faces, _ = joined(*(grid(side, 1, 1) for side in roof))
    normals = np.tile((0.0, 0.0, 1.0), (len(vertices), 1))
    thing = Thing(vertices, faces, normals=normals)
    scene = scene_of(thing)
    with RayPool(1) as pool:
        tracer = Tracer.build(scene.surfaces.vertices.astype(np.float32), scene.surfaces.triangles)
        assert len(place_receivers([receiver_of(thing)], tracer, pool)) == 6


def test_opposite_faces_at_one_place_do_not_share():
    up = receiver_of(Thing(*grid(SQUARE, 2, 2)))
    down = receiver_of(Thing(*grid(SQUARE[::-1], 2, 2)))
    assert len(build_receivers([up, down], UNIT)) == 18


@pytest.mark.parametrize("divisions", [1, 3, 40])
def test_border_receivers_are_moved_into_their_faces_a_little(divisions):
    mesh = receiver_of(Thing(*grid(SQUARE, divisions, divisions)))
    receivers = build_receivers([mesh], UNIT)
    places = np.zeros((len(receivers), 3))
    places[receivers.corner_receivers[0]] = mesh.positions[mesh.corner_vertices]
    rim = (np.abs(places[:, :2]) > 0.5 - 1e-9).any(axis=1)
    np.testing.assert_array_equal(receivers.borders, rim)
    np.testing.assert_array_equal(receivers.points[~rim], places[~rim].astype(np.float32))
    assert (np.abs(receivers.points[rim, :2]).max(axis=1) < 0.5 - 0.7 * OFFSET).all()
    np.testing.assert_array_equal(receivers.points[:, 2], 0)
    step = np.linalg.norm(receivers.points - places, axis=1)[rim]
    assert (step >= 3.9 * OFFSET).all() and (step <= max(INSET / divisions, 4.1 * OFFSET)).all()


def test_moves_stay_within_tiny_faces():
    tiny = np.array(SQUARE) * 1e-6
    receivers = build_receivers([receiver_of(Thing(*grid(tiny, 1, 1)))], UNIT)
    assert (np.abs(receivers.points[:, :2]) < 0.5e-6).all()
    assert (np.linalg.norm(receivers.points[:, :2], axis=1) > 0.2e-6).all()


@pytest.mark.parametrize("long", [0.25, 1.0])
def test_receivers_on_a_reentrant_corner_are_moved_off_both_walls(long):
    # The floor of an L: three faces around the corner at the origin, the fourth quarter is wall.
    parts = [
        [(-0.125, -0.125), (0, -0.125), (0, 0), (-0.125, 0)],
        [(0, -0.125), (long, -0.125), (long, 0), (0, 0)],
        [(-0.125, 0), (0, 0), (0, long), (-0.125, long)],
    ]
    vertices = np.array([(*corner, 0.0) for part in parts for corner in part])
    mesh = receiver_of(Thing(vertices, np.arange(12).reshape(3, 4)))
    receivers = build_receivers([mesh], UNIT)
    row = receivers.corner_receivers[0][2]
    assert (receivers.points[row, :2] < -2 * OFFSET).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_have_no_receiver(value):
    mesh = receiver_of(Thing(*grid(SQUARE, 3, 3)))
    positions = mesh.positions.copy()
    positions[5] = value
    receivers = build_receivers([replace(mesh, positions=positions)], UNIT)
    rows = receivers.corner_receivers[0]
    np.testing.assert_array_equal(rows < 0, mesh.corner_vertices == 5)
    assert len(receivers) == 15
    assert np.isfinite(receivers.points).all() and np.isfinite(receivers.sizes).all()
    assert receivers.edges.min() >= 0 and receivers.edges.max() < 15


@pytest.mark.parametrize("normal", [np.nan, 0.0])
def test_corners_without_a_normal_have_no_receiver(normal):
    mesh = receiver_of(Thing(*grid(SQUARE, 1, 1)))
    normals = mesh.corner_normals.copy()
    normals[1] = normal
    receivers = build_receivers([replace(mesh, corner_normals=normals)], UNIT)
    np.testing.assert_array_equal(receivers.corner_receivers[0], [0, -1, 1, 2])


def test_nothing_gives_no_receivers():
    assert len(build_receivers([], UNIT)) == 0
    empty = replace(
        receiver_of(Thing(*grid(SQUARE, 1, 1))),
        corner_vertices=np.empty(0, np.int32),
        corner_normals=np.empty((0, 3), np.float32),
        face_offsets=np.zeros(1, np.int32),
    )
    receivers = build_receivers([empty], UNIT)
    assert len(receivers) == 0 and len(receivers.corner_receivers) == 1


def test_sizes_are_half_the_spacing_of_a_regular_mesh():
    receivers = build_receivers([receiver_of(Thing(*grid(SQUARE, 10, 10)))], UNIT)
    np.testing.assert_allclose(receivers.sizes, 0.05 * np.sqrt(2), rtol=1e-5)


@pytest.mark.parametrize("scale", [1e-5, 1e5])
def test_frame_takes_away_size_and_place(scale):
    mesh = cornell_box(6).receivers[0]
    shift = np.array([3.0, -5.0, 2.0]) * 1e3 * scale
    there = replace(mesh, positions=mesh.positions * scale + shift)
    one = build_receivers([mesh], Frame.around(mesh.positions))
    other = build_receivers([there], Frame.around(there.positions))
    np.testing.assert_array_equal(one.corner_receivers[0], other.corner_receivers[0])
    np.testing.assert_allclose(other.points, one.points, atol=1e-6)


def test_normals_by_vertex_say_the_same_as_by_corner():
    mesh = inward_sphere(6).receivers[0]
    by_vertex = np.empty((len(mesh.positions), 3), np.float32)
    by_vertex[mesh.corner_vertices] = mesh.corner_normals
    frame = Frame.around(mesh.positions)
    # The builder's corner normals of one vertex differ by rounding: compare with the very same ones.
    one = build_receivers([replace(mesh, corner_normals=by_vertex[mesh.corner_vertices])], frame)
    other = build_receivers([replace(mesh, corner_normals=None, vertex_normals=by_vertex)], frame)
    for name in ("points", "normals", "sizes", "edges", "borders", "inward"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.corner_receivers[0], other.corner_receivers[0])


def test_triangles_without_area_change_nothing():
    square = Thing(np.array(SQUARE, float), np.array([(0, 1, 2), (0, 2, 3)]))
    # As a bevel clamped to nothing leaves them: two corners in one place, and three on a line.
    vertices = np.array([*SQUARE, SQUARE[1], (-0.5, -1.5, 0)], float)
    slivers = receiver_of(Thing(vertices, np.array([(0, 1, 2), (0, 2, 3), (0, 1, 4), (0, 3, 5)])))
    normals = np.zeros_like(slivers.corner_normals)
    normals[:, 2] = 1
    slivers = replace(slivers, corner_normals=normals)
    expected, found = (build_receivers([mesh], UNIT) for mesh in (receiver_of(square), slivers))
    rows, same = expected.corner_receivers[0], found.corner_receivers[0][:6]
    np.testing.assert_allclose(found.points[same], expected.points[rows], atol=1e-7)
    np.testing.assert_allclose(found.inward[same], expected.inward[rows], atol=1e-6)
    # The second corner's sides are the square's and one without length.
    assert found.sizes[same[1]] == pytest.approx(expected.sizes[rows[1]], rel=1e-6)
