"""Adaptive subdivision: where it divides, what it reuses, and what it must agree with."""

from functools import cache

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.conforming import conforming_mesh
from radiosity.core.discretization.hierarchy import SubdivisionLimits
from radiosity.core.solvers.two_level import PatchRows

from benchmarks.solver_scenes import SCENES

LIMITS = SubdivisionLimits(patch_max=600, patch_min=300, element_max=250, element_min=60, max_elements=5000)
FACTOR_ERROR = 1e-2


def floor_with_table(emission=5.0):
    """A floor, a table board above it, and a small lamp above both; nothing else."""
    rectangle = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    down = rectangle[::-1]
    polygons = [2 * rectangle, rectangle * 0.4 + (0, 0, 0.5), down * 0.4 + (0, 0, 0.49), down * 0.1 + (0, 0, 1.5)]
    return core.Environment.from_polygons(polygons, [0.5, 0.5, 0.5, 0], [0, 0, 0, emission])


def solve(environment, error, **choices):
    choices = {"limits": LIMITS, "accuracy": FACTOR_ERROR, "factor_method": "contour_integral"} | choices
    return core.solve(environment, method="adaptive", error=error, **choices)


@cache
def solved_table(error):
    """The floor with its table, solved once for all tests that only look."""
    return solve(floor_with_table(), error)


def test_elements_are_small_along_the_shadow_edge_only():
    # Differences of the light's fall with distance stay below this error.
    solution = solved_table(0.7)
    hierarchy = solution.hierarchy
    floor = hierarchy.elements[hierarchy.surfaces[hierarchy.elements] == 0]
    middles, areas = hierarchy.corners[floor].mean(axis=1), hierarchy.areas[floor]
    # The board's shadow on the floor, as seen from the lamp's middle: 0.4 grown by 1.5 / (1.5 - 0.5).
    distances = np.abs(np.abs(middles[:, :2]).max(axis=1) - 0.6)
    assert areas.max() >= 8 * areas.min()
    assert distances[areas == areas.min()].max() < 0.3
    assert areas[distances > 0.9].min() == areas.max()


def test_nothing_is_divided_where_light_is_even():
    # A furnace: rows sum to 1 and all glows alike.
    polygons = [SCENES["two_rooms"]().polygons[row] for row in range(6)]
    environment = core.Environment.from_polygons(polygons, 0.5, 1.0)
    solution = solve(environment, 1e-3, factor_method="auto")
    assert solution.rows == len(solution.elements)
    np.testing.assert_allclose(solution.elements, 2.0, rtol=1e-4)


def test_result_is_that_of_its_own_elements_from_scratch():
    solution = solved_table(0.4)
    hierarchy = solution.hierarchy
    rows = PatchRows(hierarchy, "contour_integral", accuracy=FACTOR_ERROR)
    again = rows.solve(hierarchy, rows.of(hierarchy, hierarchy.elements), "auto", 1e-6, None, None)
    # Sums over rows, in another order for another number of rows.
    np.testing.assert_allclose(again.elements, solution.elements, rtol=1e-13)
    # Halving n elements costs 2 n rows and leaves n more elements: less than twice the rows of the result.
    assert len(solution.elements) < solution.rows < 2 * len(solution.elements)


def test_smaller_error_divides_more_and_keeps_limits():
    counts = []
    for error in (1.0, 0.7, 0.4):
        solution = solved_table(error)
        counts.append(len(solution.elements))
        assert not len(solution.hierarchy.crowded())
    assert counts[0] < counts[1] < counts[2]
    capped = solve(floor_with_table(), 0.4, limits=SubdivisionLimits(600, 300, 250, 60, max_elements=counts[0]))
    assert len(capped.elements) <= counts[0]


def test_brightness_of_the_light_does_not_matter():
    one, other = solved_table(0.4), solve(floor_with_table(5e-7), 0.4)
    np.testing.assert_array_equal(one.hierarchy.corners, other.hierarchy.corners)
    np.testing.assert_allclose(other.elements * 1e7, one.elements, rtol=1e-9)


def test_darkness_is_not_divided():
    solution = solve(floor_with_table(0.0), 1e-3)
    assert not solution.elements.any() and solution.rows == len(solution.elements)


def test_threads_and_repetition_do_not_matter():
    one, other = (
        core.solve(SCENES["two_rooms"](), method="adaptive", error=0.5, limits=LIMITS, accuracy=0.01, threads=threads)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.elements, other.elements)


def test_shading_has_no_gaps():
    mesh = conforming_mesh(solved_table(0.4).hierarchy)
    floor = mesh.triangles[mesh.surfaces[mesh.triangles[:, 0]] == 0]
    sides = np.sort(np.concatenate([floor[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    sides, counts = np.unique(sides, axis=0, return_counts=True)
    border = mesh.vertices[sides[counts == 1]]
    assert counts.max() == 2
    assert (np.abs(border[:, :, :2]).max(axis=2) == 2).all()


@pytest.mark.parametrize("error", [0, -1, float("nan")])
def test_errors_of_nothing_are_refused(error):
    with pytest.raises(core.errors.SettingsError, match="must be above 0"):
        solve(floor_with_table(), error)
