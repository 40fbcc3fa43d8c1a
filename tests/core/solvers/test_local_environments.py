"""Black and transparent boundaries: what they keep, and how they agree with the undivided solution."""

import sys

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import Hierarchy, SubdivisionLimits
from radiosity.core.discretization.local_environments import cut_at, partition
from radiosity.core.errors import MissingRayEngineError, SettingsError
from radiosity.core.form_factors.matrix import METHODS
from radiosity.core.solvers import SOLVERS, portal_exchange
from radiosity.core.solvers.cell_factors import cell_factors
from radiosity.core.solvers.transparent_boundary import relative_error, transparent_factors
from radiosity.core.visibility import embree

from benchmarks.form_factor_scenes import box
from benchmarks.solver_scenes import SCENES, row_of_rooms

BOTH = ["black_boundary", "transparent_boundary"]
#: Inside Blender the tests put the package together by themselves, which a process of its own cannot see.
IS_INSIDE_BLENDER = "bpy" in sys.modules and bool(sys.modules["bpy"].app.binary_path)


def divided(environment, size=200):
    tree = Hierarchy.build(environment, SubdivisionLimits(patch_max=size, patch_min=size / 2))
    return tree.polygons(tree.patch_nodes)


def screened(width=0.5, divisions=2, reflectance=0.6, emission=None, without=()):
    """A box of 4 x 2 x 2 parted by a screen, which leaves a gap of some width at the side; the left floor glows."""
    polygons = [
        polygon + np.array((start, 0, 0))
        for start, inside in ((0, 1), (2, 0))
        for polygon in box((0, 0, 0), (2, 2, 2), inward=True, divisions=divisions, without=(inside, *without))
    ]
    count = len(polygons)
    if width < 2:
        polygons.append(np.array([(2, 0, 0), (2, 2 - width, 0), (2, 2 - width, 2), (2, 0, 2)], dtype=float))
    if emission is None:
        centers = np.array([polygon.mean(axis=0) for polygon in polygons])
        emission = (centers[:, 2] == 0) & (centers[:, 0] < 2)
    return core.Environment.from_polygons(
        polygons, reflectance, np.broadcast_to(np.asarray(emission, float), len(polygons)),
        np.arange(len(polygons)) >= count,
    )  # fmt: skip


def cut(environment):
    return cut_at(environment, (1, 0, 0, 2))


def error_of(environment, solution, reference):
    return relative_error(environment, np.abs(solution.radiosity - reference.radiosity), reference.radiosity)


@pytest.fixture(scope="module")
def rooms():
    """Two rooms and a row of four furnished ones, lit in the first alone: solved undivided, and by both strategies."""
    found = {}
    for name, environment in (
        ("two_rooms", divided(SCENES["two_rooms"]())),
        ("row", divided(row_of_rooms(4, lit=(0,)), 250)),
    ):
        factors = core.form_factors(environment, "hemisphere", accuracy=1.5e-3)
        whole = core.solve(environment, factors, "gmres", tolerance=1e-9)
        cells = partition(environment)
        solutions = {
            m: core.solve(environment, method=m, cells=cells, factor_method="hemisphere", accuracy=3e-3) for m in BOTH
        }
        found[name] = environment, whole, solutions
    return found


@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize("name, cells", [("two_rooms", 2), ("row", 4)])
def test_agrees_with_the_undivided_solution_within_the_error_it_states(rooms, name, cells, method):
    environment, whole, solutions = rooms[name]
    solution = solutions[method]
    assert solution.converged and solution.method == method and solution.partition.count == cells
    # Its own two standard errors leave room for the one of the undivided solution.
    assert error_of(environment, solution, whole) < solution.estimated_error < 0.15
    assert (solution.errors >= 0).all() and solution.errors.shape == environment.emission.shape


def test_black_portals_lose_direction_and_the_estimate_tells_how_much(rooms):
    environment, whole, solutions = rooms["two_rooms"]
    black, clear = (solutions[method] for method in BOTH)
    behind = environment.centroids[:, 0] > 4.1
    true = np.abs(black.radiosity - whole.radiosity)[behind].mean()
    # The far room takes its light from the doorway alone: there black portals err by much more than lines do.
    assert true > 2 * np.abs(clear.radiosity - whole.radiosity)[behind].mean()
    assert 0.7 < black.errors[behind].mean() / true < 3
    assert black.estimated_error > clear.estimated_error


@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize("width", [2, 0.5, 1e-3, 1e-6, 0])
def test_furnace_glows_evenly_through_doors_of_any_width(width, method):
    environment = screened(width, reflectance=0.5, emission=1)
    solution = core.solve(environment, method=method, cells=cut(environment), tolerance=1e-12, accuracy=0.01)
    # A door below the tolerance of planes is closed.
    assert (solution.partition.portals is None) == (width < 1e-4)
    # Row sums hold to rounding, as those of closed cells do.
    np.testing.assert_allclose(solution.radiosity, 2, rtol=1e-9)


def four_rooms():
    """A house of 4 x 4 x 2 m, parted by two thin walls that cross; each of their four halves has a doorway."""
    polygons = box((0, 0, 0), (4, 4, 2), inward=True, divisions=4)
    count = len(polygons)
    for across in (False, True):
        for start, end in ((0, 0.5), (1.2, 2.9), (3.6, 4)):
            wall = np.array([(2, start, 0), (2, end, 0), (2, end, 2), (2, start, 2)], dtype=float)
            polygons.append(wall[:, [1, 0, 2]] if across else wall)
    return core.Environment.from_polygons(polygons, 0.5, 1, np.arange(len(polygons)) >= count)


@pytest.mark.parametrize("method", BOTH)
def test_furnace_of_rooms_around_a_crossing_glows_evenly(method):
    environment = four_rooms()
    cells = cut_at(environment, [(1, 0, 0, 2), (0, 1, 0, 2)])
    assert cells.count == 4 and len(np.unique(np.sort(cells.portal_cells, axis=1), axis=0)) == 4
    solution = core.solve(environment, method=method, cells=cells, tolerance=1e-12, accuracy=0.01)
    np.testing.assert_allclose(solution.radiosity, 2, rtol=1e-9)


@pytest.mark.parametrize("method", BOTH)
def test_rooms_around_a_crossing_agree_with_the_undivided_solution(method):
    house = four_rooms()
    emission = np.where((house.centroids < 2).all(axis=1) & ~house.two_sided, 1.0, 0.0)
    environment = core.Environment.from_polygons(house.polygons, 0.6, emission, house.two_sided)
    whole = core.solve(environment, core.form_factors(environment, "hemisphere", accuracy=2e-3), "direct")
    cells = cut_at(environment, [(1, 0, 0, 2), (0, 1, 0, 2)])
    solution = core.solve(environment, method=method, cells=cells, factor_method="hemisphere", accuracy=1e-2)
    assert error_of(environment, solution, whole) < solution.estimated_error < 0.1


@pytest.mark.parametrize("method", BOTH)
def test_a_door_that_closes_leads_to_the_closed_rooms(method):
    found = {}
    for width in (0.1, 1e-3, 0):
        environment = screened(width)
        found[width] = core.solve(environment, method=method, cells=cut(environment), accuracy=1e-3).radiosity
    # Light that passes is in proportion to the width.
    far, near = (np.abs(found[width] - found[0]).max() for width in (0.1, 1e-3))
    assert 0 < near < 0.02 * far


@pytest.mark.parametrize("width", [0.5, 1.9])
def test_bright_rooms_settle_in_few_sweeps(width):
    environment = screened(width, reflectance=0.999)
    solution = core.solve(environment, method="black_boundary", cells=cut(environment), accuracy=0.01, estimate=False)
    assert solution.converged and solution.iterations <= 20
    # What is emitted is absorbed but for the residual, over the thousandth that walls take at each reflection.
    arriving = (solution.radiosity - environment.emission) / environment.reflectance
    absorbed, emitted = environment.areas @ (0.001 * arriving), environment.areas @ environment.emission
    np.testing.assert_allclose(absorbed, emitted, rtol=2e-6)


@pytest.mark.parametrize("method", BOTH)
def test_power_in_equals_power_absorbed(method):
    environment = screened(reflectance=0.8)
    solution = core.solve(environment, method=method, cells=cut(environment), tolerance=1e-13)
    emitted = environment.areas @ environment.emission
    arriving = (solution.radiosity - environment.emission) / environment.reflectance
    np.testing.assert_allclose(environment.areas @ (0.2 * arriving), emitted, rtol=1e-9)


def test_transparent_factors_are_reciprocal_and_closed():
    environment = divided(row_of_rooms(3), 100)
    cells = partition(environment)
    found = transparent_factors(cells, cell_factors(cells, "hemisphere", accuracy=0.02), 0.02)
    count = len(environment)
    matrix = found @ np.eye(count)
    exchange = environment.areas[:, None] * matrix
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-12 * environment.areas.max())
    assert (matrix >= 0).all() and matrix.sum(axis=1).max() < 1 + 1e-9
    assert found.exchange.unbalanced < 1e-9
    # Rooms see each other through two doorways, too.
    far = exchange[np.ix_(environment.centroids[:, 0] < 5, environment.centroids[:, 0] > 10.3)]
    assert far.sum() > 0
    inside = sum(
        np.bincount(cell.patches, cell.areas[: len(cell.patches)] * cell.matrix[: len(cell.patches)].sum(axis=1), count)
        for cell in found.cells
    )
    # What goes into doorways arrives, or is lost to what no patch sees from there.
    lost = inside - exchange.sum(axis=1)
    assert lost.min() > -1e-9 and lost.sum() < 1e-3 * inside.sum()


def test_what_rooms_exchange_through_several_doorways_is_that_of_the_doorways():
    environment = divided(row_of_rooms(4, furnished=False), 400)
    cells = cut_at(environment, [(1, 0, 0, 5.1 * room) for room in (1, 2, 3)])
    found = transparent_factors(cells, cell_factors(cells, "hemisphere", accuracy=0.01), 2e-3)
    exchange = environment.areas[:, None] * (found @ np.eye(len(environment)))
    low, high = (np.array([end(polygon[:, 0]) for polygon in environment.polygons]) for end in (np.min, np.max))
    first, last = (low < 5.05) & (high < 5.1 + 1e-9), low > 15.3 - 1e-9
    # What leaves through the first doorway and passes the last one has passed that in between, as they are alike.
    near, middle, far = (np.array([(x, 1.5, 0), (x, 2.4, 0), (x, 2.4, 2.1), (x, 1.5, 2.1)]) for x in (5.0, 5.1, 15.3))
    expected = [0.9 * 2.1 * core.form_factor(door, far[::-1]) for door in (near, middle)]
    # Some 1,500 lines, and the doorway's own sides, which add little: 10 % is four standard errors.
    assert 0.9 * expected[0] < exchange[np.ix_(first, last)].sum() < 1.1 * expected[1]


def test_stated_error_of_lines_is_theirs(monkeypatch):
    environment = screened()
    cells = cut(environment)
    factors = cell_factors(cells, accuracy=1e-5)
    many = transparent_factors(cells, factors, 1e-3) @ environment.emission
    for lines in (4, 256):
        monkeypatch.setattr(portal_exchange, "FIRST_LINES", lines)
        ratios = []
        for seed in range(20):
            # An accuracy that any number of lines meets.
            few = transparent_factors(cells, factors, 1 / portal_exchange.LINE_ACCURACY, seed)
            stated = few.standard_errors(environment.emission)
            ratios.append(((few @ environment.emission - many) ** 2).sum() / (stated**2).sum())
        # Even points err less than the random ones that are assumed; 20 seeds tell the mean to a third.
        assert 0.1 < np.mean(ratios) < 1.4


@pytest.mark.parametrize("method", BOTH)
def test_closed_rooms_are_solved_each_by_itself(method):
    environment = screened(width=0)
    cells = cut(environment)
    assert cells.portals is None and cells.count == 2
    solution = core.solve(environment, method=method, cells=cells, tolerance=1e-12)
    right = (environment.centroids[:, 0] > 2) & ~environment.two_sided
    assert not solution.radiosity[right & (environment.reflectance[:, 0] == 0)].any()
    whole = core.solve(environment, core.form_factors(environment), tolerance=1e-12)
    # The screen has one radiosity for both sides: it alone lights the room behind it.
    np.testing.assert_allclose(solution.radiosity, whole.radiosity, rtol=1e-6)
    assert solution.estimated_error < 1e-4


@pytest.mark.parametrize("method", BOTH)
def test_a_cell_without_light_is_dark_where_nothing_is_open(method):
    environment = divided(row_of_rooms(3, furnished=False, lit=(1,), doorway=False), 300)
    cells = cut_at(environment, [(1, 0, 0, 5.1), (1, 0, 0, 10.2)])
    assert cells.count == 3 and cells.portals is None
    solution = core.solve(environment, method=method, cells=cells, factor_method="hemisphere", accuracy=0.01)
    lamp = environment.emission.any(axis=1)[cells.patches]
    lit = np.bincount(cells.patches[cells.cells == cells.cells[lamp][0]], minlength=len(environment)) > 0
    assert solution.converged and solution.radiosity[lit].any()
    assert not solution.radiosity[~lit].any()


@pytest.mark.parametrize("method", BOTH)
def test_one_cell_is_the_undivided_solution(method):
    environment = divided(SCENES["furnished_room"](), 500)
    solution = core.solve(environment, method=method, factor_method="hemisphere", accuracy=0.01, tolerance=1e-12)
    assert solution.partition.count == 1
    factors = core.form_factors(environment, "hemisphere", accuracy=0.01)
    whole = core.solve(environment, factors, "direct")
    np.testing.assert_allclose(solution.radiosity, whole.radiosity, rtol=1e-8, atol=1e-10)


def test_light_through_an_empty_plane_comes_as_if_there_were_none():
    # No wall at all: every wall and the floor are cut, and the opening is as wide as the box.
    environment = core.Environment.from_polygons(
        box((0, 0, 0), (4, 2, 2), inward=True), 0.6, [0, 0, 0, 0, 1, 0]
    )  # fmt: skip
    whole = core.solve(environment, core.form_factors(environment), "direct")
    clear = core.solve(environment, method="transparent_boundary", cells=cut(environment), accuracy=1e-4)
    assert error_of(environment, clear, whole) < clear.estimated_error < 0.01
    black = core.solve(environment, method="black_boundary", cells=cut(environment), accuracy=1e-4)
    assert error_of(environment, black, whole) < black.estimated_error


def test_error_of_transparent_boundaries_falls_with_the_accuracy():
    environment = screened(reflectance=0.6)
    whole = core.solve(environment, core.form_factors(environment, accuracy=1e-5), "direct")
    errors, stated = [], []
    for accuracy in (1e-2, 1e-4):
        solution = core.solve(environment, method="transparent_boundary", cells=cut(environment), accuracy=accuracy)
        errors.append(error_of(environment, solution, whole))
        stated.append(solution.estimated_error)
    assert errors[0] < stated[0] and errors[1] < stated[1]
    # Lines err by the root of their number at most: a hundredth of the accuracy is a hundredth of the error.
    assert errors[1] < errors[0] / 10 and stated[1] < stated[0] / 10


@pytest.fixture(scope="module")
def exact():
    """A screened box and its solution by exact clipping."""
    environment = screened(divisions=1)
    factors = core.form_factors(environment, "point_to_polygon", "bsp", accuracy=1e-5)
    return environment, core.solve(environment, factors, "direct")


@pytest.mark.parametrize("factor_method", METHODS)
def test_any_method_of_factors_serves(exact, factor_method):
    environment, whole = exact
    for method in BOTH:
        solution = core.solve(
            environment, method=method, cells=cut(environment), factor_method=factor_method, accuracy=0.01
        )
        assert solution.converged
        assert error_of(environment, solution, whole) < solution.estimated_error


@pytest.mark.parametrize("method", BOTH)
def test_light_that_leaves_the_scene_is_lost_through_portals_too(method):
    environment = screened(width=1, without=(5,))  # no ceiling
    whole = core.solve(environment, core.form_factors(environment, accuracy=1e-4), "direct")
    solution = core.solve(environment, method=method, cells=cut(environment), accuracy=5e-3)
    assert error_of(environment, solution, whole) < solution.estimated_error < 0.3


@pytest.mark.parametrize("solver", SOLVERS)
def test_cells_are_solved_by_any_solver(solver):
    environment = screened()
    cells = cut(environment)
    found = core.solve(environment, method="black_boundary", cells=cells, solver=solver, tolerance=1e-9, estimate=False)
    usual = core.solve(environment, method="black_boundary", cells=cells, tolerance=1e-12, estimate=False)
    assert found.converged and found.residual <= 1e-9
    # What is missing is at most the residual over 1 minus the reflectance, in power.
    missing = environment.areas @ np.abs(found.radiosity - usual.radiosity)
    assert (missing <= 1e-8 * (environment.areas @ environment.emission)).all()


def test_without_an_estimate_there_is_no_error_stated():
    environment = screened()
    solution = core.solve(environment, method="black_boundary", cells=cut(environment), estimate=False)
    assert np.isnan(solution.estimated_error) and solution.errors is None
    checked = core.solve(environment, method="black_boundary", cells=cut(environment))
    np.testing.assert_array_equal(solution.radiosity, checked.radiosity)


def test_only_the_estimate_needs_the_ray_engine(monkeypatch):
    def missing(*arguments):
        raise MissingRayEngineError("not on this platform")

    monkeypatch.setattr(embree.Tracer, "build", missing)
    environment = screened(divisions=1)
    choices = {"cells": cut(environment), "factor_method": "hemicube", "accuracy": 0.05}
    assert core.solve(environment, method="black_boundary", estimate=False, **choices).converged
    for method in BOTH:
        with pytest.raises(MissingRayEngineError):
            core.solve(environment, method=method, **choices)


@pytest.mark.parametrize("method", BOTH)
def test_darkness_stays_dark(method):
    environment = screened(emission=0)
    solution = core.solve(environment, method=method, cells=cut(environment))
    assert not solution.radiosity.any() and solution.converged and solution.estimated_error == 0


@pytest.mark.parametrize("method", BOTH)
def test_result_does_not_depend_on_threads(method):
    environment = screened()
    one, two = (
        core.solve(environment, method=method, cells=cut(environment), factor_method="hemisphere", accuracy=0.01,
                   threads=threads)
        for threads in (1, 2)
    )  # fmt: skip
    np.testing.assert_array_equal(one.radiosity, two.radiosity)
    np.testing.assert_array_equal(one.errors, two.errors)


@pytest.mark.skipif(IS_INSIDE_BLENDER, reason="another process cannot import the package")
def test_factors_do_not_depend_on_processes():
    cells = cut(screened())
    here, there = (cell_factors(cells, "hemisphere", accuracy=0.02, workers=workers) for workers in (1, 2))
    for one, other in zip(here, there, strict=True):
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(other, name))


def test_callback_sees_patches_only_and_stops():
    environment = screened(reflectance=0.9)
    seen = []

    def stop(state):
        seen.append((state.radiosity.shape, state.unshot.shape))
        return state.iteration == 2

    solution = core.solve(
        environment, method="black_boundary", cells=cut(environment), callback=stop, tolerance=0, estimate=False
    )
    assert seen == [(environment.emission.shape,) * 2] * 2
    assert solution.iterations == 2 and solution.ended_by == "callback"


@pytest.mark.parametrize(
    "choices, reason",
    [
        ({"cells": cut(screened())}, "belong to another environment"),
        ({"tolerance": -1}, "Tolerance must be finite"),
        ({"max_iterations": -1}, "Maximum iterations"),
        ({"factor_method": "magic"}, "Unknown form-factor method 'magic'"),
        ({"accuracy": 0}, "Accuracy of form factors"),
        ({"workers": -1}, "Workers must be a whole number"),
        ({"workers": 1.5}, "Workers must be a whole number"),
        ({"batch": 2}, "Unknown option 'batch'"),
        ({"start": np.zeros((3, 3))}, "makes its own patches and form factors"),
    ],
)
@pytest.mark.parametrize("method", BOTH)
def test_what_does_not_suit_is_refused(method, choices, reason):
    with pytest.raises(SettingsError, match=reason):
        core.solve(screened(divisions=1), method=method, **choices)


def test_an_unknown_solver_of_cells_is_refused():
    with pytest.raises(SettingsError, match="Unknown solver 'magic': choose direct"):
        core.solve(screened(divisions=1), method="black_boundary", solver="magic")
