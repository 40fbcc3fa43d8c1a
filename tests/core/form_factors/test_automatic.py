"""The automatic choice: no rays where nothing can block, exact clipping in small rooms, rays in large ones."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.form_factors import automatic
from radiosity.core.form_factors.hemisphere import hemisphere_rows

from tests.reference_cases import form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
CONVEX = ["enc-cube", "enc-box-5-4-3", "enc-box-7-3-2", "enc-tetra", "enc-prism"]
#: The Cornell box takes 3 s, the doorway is made below.
BLOCKED = ["enc-L-room", "enc-facet-8", "enc-two-sealed-cubes", "enc-box345-1cube", "enc-cornell"]


def deviation(name, accuracy):
    case = CASES[name]
    matrix, _, result = surface_matrix(case, accuracy=accuracy)
    expected = np.array(case["matrix"]["F"])
    return np.abs(in_order(case, matrix, case["matrix"]["order"]) - expected).max(), result


def divided_box(count):
    """A closed box of count x count patches a side."""
    steps = np.linspace(0, 1, count + 1)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    polygons = []
    for axis in range(3):
        for side in (0.0, 1.0):
            for low in steps[:-1]:
                for left in steps[:-1]:
                    loop = np.empty((4, 3))
                    loop[:, axis] = side
                    loop[:, [(axis + 1) % 3, (axis + 2) % 3]] = np.array([low, left]) + unit / count
                    polygons.append(loop if side == 0 else loop[::-1])
    return polygons


@pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
@pytest.mark.parametrize("name", CONVEX)
def test_a_convex_room_traces_no_ray_and_closes(name, accuracy):
    error, result = deviation(name, accuracy)
    assert result.rays == 0 and set(result.method_counts) == {"contour_integral"}
    assert result.closed and np.abs(result.matrix.sum(axis=1) - 1).max() <= 1e-12
    # Far below what is asked for; the reference has 9 digits and more.
    assert error <= max(0.01 * accuracy, 1e-9) and result.estimated_error <= accuracy


@pytest.mark.parametrize("accuracy", [1e-3, 1e-6])
def test_a_divided_convex_room_traces_no_ray_and_closes(accuracy):
    result = core.form_factors(core.Environment.from_polygons(divided_box(5)), accuracy=accuracy)
    assert result.rays == 0 and result.method_counts == {"contour_integral": 150 * 149 // 2}
    assert result.closed and result.closure_error <= 1e-12
    # Before the repair, too, a row is off by little of what is asked for a single factor.
    assert result.raw_closure_error <= 0.1 * accuracy


@pytest.mark.parametrize("name", BLOCKED)
def test_an_obstructed_enclosure_keeps_the_accuracy_asked_for(name):
    error, result = deviation(name, 1e-4)
    assert error <= result.estimated_error <= 1e-4
    assert result.rays == 0 and {"contour_integral", "point_to_polygon"} == set(result.method_counts)
    count = len(result.matrix)
    assert sum(result.method_counts.values()) == count * (count - 1) // 2
    assert result.closed == (name != "enc-cornell")


@pytest.mark.parametrize("name", ["enc-L-room", "enc-facet-8", "enc-two-sealed-cubes"])
def test_a_small_obstructed_enclosure_keeps_1e_6(name):
    error, result = deviation(name, 1e-6)
    assert error <= result.estimated_error <= 1e-6


def doorway():
    """Two rooms of 1 x 1 x 1 side by side, and a wall of two-sided parts between them with an opening."""
    room = [loop * [2, 1, 1] for loop in divided_box(1)]
    outlines = [[(0, 0), (0.3, 0), (0.3, 1), (0, 1)], [(0.6, 0), (1, 0), (1, 1), (0.6, 1)]]
    outlines.append([(0.3, 0.7), (0.6, 0.7), (0.6, 1), (0.3, 1)])
    wall = [np.array([[1, y, z] for y, z in outline]) for outline in outlines]
    return core.Environment.from_polygons([*room, *wall], two_sided=[False] * 6 + [True] * 3)


def test_a_doorway_between_two_rooms():
    exact, quick = (core.form_factors(doorway(), accuracy=accuracy) for accuracy in (1e-6, 1e-4))
    rays = core.form_factors(doorway(), method="hemisphere", accuracy=4e-3)
    assert exact.closed and quick.closed and quick.rays == 0
    assert np.abs(quick.matrix - exact.matrix).max() <= quick.estimated_error <= 1e-4
    # Three standard errors of a factor of a half.
    assert np.abs(rays.matrix - exact.matrix).max() <= 4e-3


def test_rays_take_over_where_clipping_costs_more(monkeypatch):
    case = CASES["enc-box345-1cube"]
    polygons, _ = polygons_of(case)
    environment = core.Environment.from_polygons(polygons)
    monkeypatch.setattr(automatic, "CLIPPED_SECONDS", 10.0)
    rows, counts = automatic.automatic_rows(environment, 4e-3)
    # Six of the twelve patches see past the cube; what the others see, nothing can block, and they cast no ray.
    assert rows.rays > 0 and counts["hemisphere"] == 6 and "point_to_polygon" not in counts
    everywhere = hemisphere_rows(environment, 4e-3)
    assert rows.rays < 0.7 * everywhere.rays
    monkeypatch.undo()
    exact, _ = automatic.automatic_rows(environment, 1e-5, seed=1)
    assert exact.rays == 0
    idle = ~automatic._blockable_patches(environment).any(axis=1)
    assert np.abs(rows.matrix - exact.matrix)[idle].max(initial=0) <= 1e-4
    # Pairs that nothing can part stay exact; the others are within four standard errors.
    error = np.abs(rows.matrix - exact.matrix)
    assert error.max() <= 4 * 4e-3 and rows.errors.max() <= 4e-3


def test_a_patch_that_is_degenerate_exchanges_nothing():
    polygons = [*divided_box(1), np.array([[0.2, 0.2, 0.2], [0.4, 0.4, 0.4], [0.8, 0.8, 0.8]])]
    with pytest.warns(UserWarning, match="without area"):
        environment = core.Environment.from_polygons(polygons)
    result = core.form_factors(environment)
    assert not result.matrix[6].any() and not result.matrix[:, 6].any()
    assert result.rays == 0 and np.abs(result.matrix[:6].sum(axis=1) - 1).max() <= 1e-12


def test_all_enclosures_of_the_reference_are_looked_at():
    assert {*CONVEX, *BLOCKED, "enc-ward-room"} == set(ids(CASES, "enclosure"))
