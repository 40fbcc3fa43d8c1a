"""Shadows of convex polyhedra on rows: exact ends against dense tests, and refusal of what is not convex."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.visibility.bsp import BspVisibility
from radiosity.core.visibility.silhouettes import NotConvexError, SilhouetteVisibility, convex_polyhedra

from tests.reference_cases import form_factor_cases, polygons_of


def box(low, high):
    """Six outward faces."""
    (x, y, z), (u, v, w) = low, high
    return [
        np.array(face, dtype=float)
        for face in (
            [[x, y, z], [x, v, z], [u, v, z], [u, y, z]],
            [[x, y, w], [u, y, w], [u, v, w], [x, v, w]],
            [[x, y, z], [u, y, z], [u, y, w], [x, y, w]],
            [[u, v, z], [x, v, z], [x, v, w], [u, v, w]],
            [[x, v, z], [x, y, z], [x, y, w], [x, v, w]],
            [[u, y, z], [u, v, z], [u, v, w], [u, y, w]],
        )
    ]


def tetrahedron(generator):
    a, b, c, d = generator.random((4, 3)) * 0.6 + 0.2
    if np.dot(np.cross(b - a, c - a), d - a) > 0:
        b, c = c, b
    return [np.array(face) for face in ([a, b, c], [a, d, b], [b, d, c], [c, d, a])]


ROOM = [face[::-1] for face in box([0, 0, 0], [1, 1, 1])]
GENERATOR = np.random.default_rng(0)
SCENES = {
    "cube": box([0.3, 0.4, 0.2], [0.6, 0.7, 0.5]),
    "cube in a room": [*ROOM, *box([0.3, 0.4, 0.2], [0.6, 0.7, 0.5])],
    "box on the floor": [*ROOM, *box([0.3, 0.4, 0], [0.6, 0.7, 0.5])[1:]],
    "two solids": [*tetrahedron(GENERATOR), *box([2, 2, 2], [3, 3, 3])],
    "plate": [*ROOM, np.array([[0.2, 0.3, 0.4], [0.8, 0.2, 0.6], [0.6, 0.8, 0.5]])],
    "two plates": [
        *ROOM,
        np.array([[0.2, 0.3, 0.4], [0.8, 0.2, 0.4], [0.6, 0.8, 0.4]]),
        np.array([[0.5, 0.1, 0.7], [0.9, 0.9, 0.7], [0.1, 0.9, 0.7]]),
    ],
}


def rows_around(count, generator):
    points = np.stack([generator.random(count), generator.random(count), generator.choice([0.02, 0.98], count)], axis=1)
    starts, ends = generator.random((2, count, 3))
    return points, starts, ends


@pytest.mark.parametrize("name", SCENES)
def test_intervals_agree_with_dense_segments(name):
    environment = core.Environment.from_polygons(SCENES[name])
    silhouettes, tree = SilhouetteVisibility(environment), BspVisibility(environment)
    points, starts, ends = rows_around(300, np.random.default_rng(1))
    steps = np.linspace(0, 1, 41)
    targets = starts[:, None] + steps[:, None] * (ends - starts)[:, None]
    wanted = tree.visible(np.repeat(points, 41, axis=0), targets.reshape(-1, 3)).reshape(300, 41)
    assert 0.02 < 1 - wanted.mean() < 0.9
    np.testing.assert_array_equal(silhouettes.visible_rows(points, starts, ends, steps), wanted)
    single = silhouettes.visible(np.repeat(points, 41, axis=0), targets.reshape(-1, 3)).reshape(300, 41)
    np.testing.assert_array_equal(single, wanted)


@pytest.mark.parametrize("name", SCENES)
def test_interval_ends_are_exact(name):
    environment = core.Environment.from_polygons(SCENES[name])
    silhouettes, tree = SilhouetteVisibility(environment), BspVisibility(environment)
    points, starts, ends = rows_around(300, np.random.default_rng(2))
    rows, intervals = silhouettes.shadow_intervals(points, starts, ends)
    assert len(rows) > 20 and (intervals >= 0).all() and (intervals <= 1).all()
    step = 1e-7
    for side, sign in ((0, 1), (1, -1)):
        inner = intervals[:, side] + sign * step
        long = (intervals[:, 1] - intervals[:, 0] > 4 * step) & (intervals[:, side] > 0) & (intervals[:, side] < 1)
        for shares, dark in ((inner, True), (intervals[:, side] - sign * step, False)):
            places = starts[rows] + shares[:, None] * (ends - starts)[rows]
            free = tree.visible(points[rows], places)
            # Another shadow may begin where one ends.
            alone = np.array([(rows == row).sum() == 1 for row in rows])
            assert (free[long & (alone | dark)] != dark).all()


def test_a_known_shadow_to_rounding():
    # A square plate of half-width 1/4 at half the height shades half-width 1/2 from straight below.
    plate = np.array([[-0.25, -0.25, 0.5], [0.25, -0.25, 0.5], [0.25, 0.25, 0.5], [-0.25, 0.25, 0.5]])
    room = [face[::-1] for face in box([-1, -1, 0], [1, 1, 1])]
    visibility = SilhouetteVisibility(core.Environment.from_polygons([*room, plate]))
    rows, intervals = visibility.shadow_intervals(
        np.zeros((1, 3)), np.array([[-1, 0.1, 1.0]]), np.array([[1, 0.1, 1.0]])
    )
    np.testing.assert_array_equal(rows, [0])
    np.testing.assert_allclose(intervals, [[0.25, 0.75]], atol=1e-14)


def test_solids_are_found_and_walls_left_out():
    found = {
        name: [len(solid.patches) for solid in convex_polyhedra(core.Environment.from_polygons(polygons))[0]]
        for name, polygons in SCENES.items()
    }
    assert found == {
        "cube": [6],
        "cube in a room": [6],
        "box on the floor": [5],
        "two solids": [4, 6],
        "plate": [1],
        "two plates": [1, 1],
    }
    cornell = core.Environment.from_polygons(polygons_of(form_factor_cases()["enc-cornell"])[0])
    assert sorted(len(solid.patches) for solid in convex_polyhedra(cornell)[0])[-2:] == [5, 5]


@pytest.mark.parametrize("name", ["enc-L-room"])
def test_rooms_that_are_not_convex_are_refused_by_name(name):
    environment = core.Environment.from_polygons(polygons_of(form_factor_cases()[name])[0])
    with pytest.raises(NotConvexError, match="polygon"):
        SilhouetteVisibility(environment)
    with pytest.raises(NotConvexError, match="bsp"):
        core.form_factors(environment, method="point_to_point")


def test_concave_polygons_are_refused_by_name():
    arrow = np.array([[2, 1, 0.5], [1, 0, 0.5], [2, -1, 0.5], [0, 0, 0.5]])
    floor, ceiling = (np.array([[-3, -3, z], [3, -3, z], [3, 3, z], [-3, 3, z]], dtype=float) for z in (0, 1))
    with pytest.raises(NotConvexError, match=r"polygon 2.*concave"):
        SilhouetteVisibility(core.Environment.from_polygons([floor, ceiling[::-1], arrow[::-1]]))
