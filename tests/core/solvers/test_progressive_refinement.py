"""Progressive refinement: the published traces step by step, exact bookkeeping, and going on from any step."""

import pickle
import time

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError, SolverError
from radiosity.core.solvers import ProgressiveRefinement

from tests.core.solvers.systems import random_system
from tests.reference_cases import ids, solution_cases

CASES = solution_cases()


def from_rows(matrix, reflectance, emission, areas):
    return ProgressiveRefinement.from_rows(lambda patches: matrix[patches], reflectance, emission, areas)


@pytest.mark.parametrize("make", [ProgressiveRefinement.from_matrix, None], ids=["matrix", "rows"])
@pytest.mark.parametrize("name", ids(CASES, "trace"))
def test_published_traces_step_by_step(name, make):
    case = CASES[name]
    matrix, reflectance, emission, areas = (np.array(case[key]) for key in ("F", "reflectance", "emission", "areas"))
    refinement = (make or from_rows)(matrix, reflectance, emission, areas)
    tolerance = {"rtol": case["tolerance"]["exact"]["rel"], "atol": 1e-15}
    for number, step in enumerate(case["expected"]["progressive"], 1):
        seen = []
        refinement.refine(tolerance=0, max_iterations=1, callback=seen.append)
        (state,) = seen
        assert (state.iteration, state.shooter, state.shooters.tolist()) == (number, step["shot"], [step["shot"]])
        np.testing.assert_allclose(state.radiosity[:, 0], step["B"], **tolerance)
        np.testing.assert_allclose(state.unshot[:, 0], step["unshot"], **tolerance)
        np.testing.assert_allclose(state.ambient, step["ambient"], **tolerance)
        np.testing.assert_allclose(refinement.displayed()[:, 0], step["B_displayed"], **tolerance)


def test_trace_by_name_through_the_common_entrance():
    case = CASES["trace-cube"]
    steps, trace = case["expected"]["progressive"], []
    solution = core.solve_radiosity(
        case["F"], case["reflectance"], case["emission"], case["areas"], "progressive_refinement", tolerance=0,
        max_iterations=len(steps), callback=lambda state: trace.append((state.shooter, *state.radiosity[:, 0])),
    )  # fmt: skip
    np.testing.assert_allclose(trace, [(step["shot"], *step["B"]) for step in steps], rtol=1e-10)
    assert solution.iterations == len(steps) and solution.ended_by == "max_iterations"


@pytest.mark.parametrize("batch", [1, 7])
@pytest.mark.parametrize("closed", [True, False])
def test_power_is_accounted_for_at_each_step(closed, batch):
    matrix, reflectance, emission, areas = random_system(1, closed=closed)
    emitted, escaped_before, residuals = areas @ emission, 0.0, []

    def check(state):
        nonlocal escaped_before
        unshot = areas @ state.unshot
        np.testing.assert_allclose(state.absorbed + state.escaped + unshot, emitted, rtol=1e-13)
        # Not by definition alone: what has been absorbed belongs to the irradiance that the radiosity shows.
        irradiance = (state.radiosity - emission) / reflectance
        # The difference from the emission keeps the radiosity's rounding, which the reflectance divides; each step adds
        # to what was absorbed, and rounds.
        rounding = areas @ ((1 - reflectance) / reflectance * state.radiosity) + state.iteration * state.absorbed
        difference = np.abs(state.absorbed - areas @ ((1 - reflectance) * irradiance))
        assert np.all(difference <= 4 * np.finfo(float).eps * rounding)
        # What escaped is what is left of sums of the size of all that was emitted.
        assert np.all(state.escaped >= escaped_before - 2 * np.finfo(float).eps * emitted)
        escaped_before = state.escaped.copy()
        residuals.append(state.residual)
        assert state.residual == pytest.approx((unshot / emitted).max(), rel=1e-14)

    solution = core.solve_radiosity(
        matrix, reflectance, emission, areas, "progressive_refinement", tolerance=1e-9, batch=batch, callback=check
    )
    assert solution.residuals[1:].tolist() == residuals
    # Shooting never adds light: the unshot share falls at each step.
    assert np.all(np.diff(solution.residuals) < 1e-16)
    assert (np.abs(escaped_before).max() < 1e-12) == closed
    balance = core.energy_balance(matrix, areas, reflectance, emission, solution.radiosity)
    np.testing.assert_allclose(balance.escaped, escaped_before, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("batch", [1, 3, 40, 100])
def test_batches_and_single_shots_reach_the_same_solution(batch):
    matrix, reflectance, emission, areas = random_system(2)
    solution = core.solve_radiosity(
        matrix, reflectance, emission, areas, "progressive_refinement", tolerance=1e-12, batch=batch
    )
    direct = core.solve_radiosity(matrix, reflectance, emission, areas).radiosity
    np.testing.assert_allclose(solution.radiosity, direct, rtol=1e-10)


def test_shooting_all_at_once_is_jacobi():
    matrix, reflectance, emission, areas = random_system(3)
    shots = core.solve_radiosity(
        matrix, reflectance, emission, areas, "progressive_refinement", tolerance=0, max_iterations=5, batch=40
    )
    sweeps = core.solve_radiosity(matrix, reflectance, emission, areas, "jacobi", tolerance=0, max_iterations=5)
    np.testing.assert_allclose(shots.radiosity, sweeps.radiosity, rtol=1e-13)


def test_ties_go_to_the_lowest_index_and_batches_take_the_strongest():
    matrix = np.full((6, 6), 0.1)
    emission = np.array([1.0, 3.0, 2.0, 3.0, 2.0, 2.0])
    for batch, order in ((1, [1]), (2, [1, 3]), (4, [1, 3, 2, 4]), (9, [1, 3, 2, 4, 5, 0])):
        seen = []
        core.solve_radiosity(
            matrix, 0.5, emission, np.ones(6), "progressive_refinement", max_iterations=1, batch=batch,
            callback=lambda state, seen=seen: seen.append(state.shooters),
        )  # fmt: skip
        assert seen[0].tolist() == order


def test_order_is_by_power_not_by_radiosity():
    seen = []
    core.solve_radiosity(
        np.zeros((2, 2)), 0.5, [3.0, 1.0], [1.0, 4.0], "progressive_refinement",
        callback=lambda state: seen.append(state.shooter),
    )  # fmt: skip
    assert seen == [1, 0]


@pytest.mark.parametrize("batch", [1, 4])
def test_interrupted_work_goes_on_bit_for_bit(batch):
    system = random_system(4)
    at_once = ProgressiveRefinement.from_matrix(*system).refine(tolerance=1e-10, batch=batch)
    refinement = ProgressiveRefinement.from_matrix(*system)
    first = refinement.refine(tolerance=1e-2, batch=batch)
    assert first.ended_by == "tolerance" and first.residual <= 1e-2
    kept = first.radiosity.copy()
    refinement.refine(tolerance=1e-10, batch=batch, callback=lambda state: state.iteration == first.iterations + 5)
    assert len(refinement.residuals) == first.iterations + 6
    saved = pickle.loads(pickle.dumps(refinement.state))
    resumed = ProgressiveRefinement.from_matrix(*system, state=saved)
    for one in (refinement, resumed):
        last = one.refine(tolerance=1e-10, batch=batch)
        assert np.array_equal(last.radiosity, at_once.radiosity) and np.array_equal(last.residuals, at_once.residuals)
        assert one.shots == batch * last.iterations
    assert np.array_equal(first.radiosity, kept)


def test_ends_when_most_light_is_absorbed():
    matrix, reflectance, emission, areas = random_system(5, closed=False)
    refinement = ProgressiveRefinement.from_matrix(matrix, reflectance, emission, areas)
    solution = refinement.refine(tolerance=0, absorbed=0.99)
    assert solution.ended_by == "absorbed" and refinement.absorbed_share() >= 0.99
    balance = core.energy_balance(matrix, areas, reflectance, emission, core.solve_radiosity(
        matrix, reflectance, emission, areas).radiosity)  # fmt: skip
    # What the whole solution absorbs is known only in the end: unshot light may yet escape.
    assert np.all(refinement.absorbed / balance.absorbed >= 0.99)
    before = ProgressiveRefinement.from_matrix(matrix, reflectance, emission, areas)
    before.refine(tolerance=0, max_iterations=solution.iterations - 1)
    assert before.absorbed_share() < 0.99


def test_ends_in_time_after_one_step_at_least():
    refinement = ProgressiveRefinement.from_matrix(*random_system(6))
    for number in (1, 2):
        solution = refinement.refine(tolerance=0, time_limit=0)
        assert solution.ended_by == "time_limit" and solution.iterations == number
    solution = refinement.refine(tolerance=0, time_limit=0.02, callback=lambda state: time.sleep(0.03))
    assert solution.ended_by == "time_limit" and solution.iterations == 3


def test_only_rows_of_shooting_patches_are_asked_for():
    matrix, reflectance, emission, areas = random_system(7)
    emission[5:] = 0
    asked = []

    def rows(patches):
        asked.extend(patches.tolist())
        return matrix[patches]

    environment = core.Environment.from_polygons(
        [np.sqrt(area) * np.array([[0, 0, i], [1, 0, i], [1, 1, i], [0, 1, i]]) for i, area in enumerate(areas)],
        reflectance,
        emission,
    )
    seen = []
    solution = core.solve(environment, rows, tolerance=0.3, callback=lambda state: seen.append(state.shooter))
    assert asked == seen and len(set(asked)) < 40
    assert solution.method == "progressive_refinement"
    exact = core.solve(environment, matrix).radiosity
    last = core.solve(environment, rows, method="progressive_refinement", tolerance=1e-12).radiosity
    np.testing.assert_allclose(last, exact, rtol=1e-10)
    for choices, reason in (({"method": "direct"}, "needs a whole matrix"), ({"start": exact}, "state instead")):
        with pytest.raises(SettingsError, match=reason):
            core.solve(environment, rows, **choices)


def test_ambient_term_is_what_is_missing_in_an_integrating_sphere():
    # Every patch sees all area evenly and reflects alike: then the estimate is exact at any step.
    areas = np.random.default_rng(8).uniform(1, 2, 30)
    matrix = np.tile(areas / areas.sum(), (30, 1))
    emission = np.where(np.arange(30) < 3, 1.0, 0.0)
    exact = core.solve_radiosity(matrix, 0.7, emission, areas).radiosity
    refinement = ProgressiveRefinement.from_matrix(matrix, 0.7, emission, areas)
    for _ in range(10):
        refinement.refine(tolerance=0, max_iterations=1)
        np.testing.assert_allclose(refinement.displayed()[:, 0], exact, rtol=1e-12)
    assert not np.allclose(refinement.radiosity[:, 0], exact, rtol=1e-3)


def test_ambient_term_is_finite_where_nothing_absorbs():
    refinement = ProgressiveRefinement.from_matrix([[0.0, 1.0], [1.0, 0.0]], 1.0, [1.0, 0.0])
    assert np.isfinite(refinement.ambient).all() and refinement.ambient[0] > 0


def test_a_faint_channel_does_not_wait_for_a_bright_one():
    matrix, reflectance, _, areas = random_system(9)
    emission = np.zeros((40, 3))
    emission[0], emission[1, 2] = [1e6, 1e6, 0], 1.0
    seen = []
    core.solve_radiosity(
        matrix, reflectance, emission, areas, "progressive_refinement", max_iterations=3,
        callback=lambda state: seen.append(state.shooter),
    )  # fmt: skip
    assert set(seen[:2]) == {0, 1}


def test_malformed_rows_are_refused():
    matrix, reflectance, emission, areas = random_system(10)
    for rows, reason in (
        (lambda patches: matrix, "Rows must be of shape"),
        (lambda patches: -matrix[patches], "negative or not finite"),
        (lambda patches: np.nan * matrix[patches], "negative or not finite"),
    ):
        with pytest.raises(SolverError, match=reason):
            ProgressiveRefinement.from_rows(rows, reflectance, emission, areas).refine()
    with pytest.raises(SolverError, match="The state is of shape"):
        state = ProgressiveRefinement.from_matrix(matrix, reflectance, emission, areas).state
        ProgressiveRefinement.from_matrix(matrix[:9, :9], 0.5, emission[:9], areas[:9], state)
    with pytest.raises(SolverError, match="runs away"):
        ProgressiveRefinement.from_rows(lambda patches: 1e200 * matrix[patches], 0.9, emission, areas).refine()
