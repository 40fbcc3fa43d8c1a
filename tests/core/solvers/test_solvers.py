"""Solvers of the radiosity equations: closed forms, each other, published traces, and what must hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity import core
from radiosity.core.errors import SettingsError, SolverError
from radiosity.core.solvers import SOLVERS, gauss_seidel

from tests.core.solvers.systems import random_system
from tests.reference_cases import ids, solution_cases

CASES = solution_cases()
METHODS = list(SOLVERS)
ITERATIVE = [name for name in METHODS if name != "direct"]
GATHERING = [name for name in ITERATIVE if name != "progressive_refinement"]


@pytest.mark.parametrize("method", [*METHODS, "auto"])
@pytest.mark.parametrize("name", ids(CASES, "matrix"))
def test_published_matrix_solutions(name, method):
    case = CASES[name]
    level = "exact" if method in ("direct", "auto") else "iterative"
    solution = core.solve_radiosity(
        case["F"], case["reflectance"], case["emission"], case["areas"], method, tolerance=1e-9, max_iterations=20_000
    )
    np.testing.assert_allclose(solution.radiosity, case["expected"]["B"], rtol=case["tolerance"][level]["rel"])
    assert solution.converged


@pytest.mark.parametrize("name", ids(CASES, "trace"))
@pytest.mark.parametrize("method", ["jacobi", "gauss_seidel"])
@pytest.mark.parametrize("block", [64, 2], ids=["one block", "blocks of two"])
def test_published_traces_step_by_step(name, method, block, monkeypatch):
    monkeypatch.setattr(gauss_seidel, "BLOCK", block)
    case = CASES[name]
    trace = []
    steps = case["expected"][method]
    solution = core.solve_radiosity(
        case["F"], case["reflectance"], case["emission"], case["areas"], method, tolerance=0,
        max_iterations=len(steps), callback=lambda state: trace.append(state.radiosity[:, 0].copy()),
    )  # fmt: skip
    np.testing.assert_allclose(trace, steps, rtol=case["tolerance"]["exact"]["rel"])
    np.testing.assert_array_equal(solution.radiosity, trace[-1])
    assert solution.iterations == len(steps) and not solution.converged


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 5, 64, 150])
def test_solution_satisfies_its_equations(method, count):
    matrix, reflectance, emission, areas = random_system(1, count)
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, method, tolerance=1e-12)
    wanted = emission + reflectance * (matrix @ solution.radiosity)
    np.testing.assert_allclose(solution.radiosity, wanted, atol=1e-11)
    left = areas @ np.abs(wanted - solution.radiosity) / (areas @ emission)
    if method == "progressive_refinement":
        # Its radiosity includes what is unshot already: what the equations miss is a reflection less.
        assert left.max() <= solution.residual + 1e-14
    else:
        assert solution.residual == pytest.approx(left.max(), abs=1e-14)
    direct = core.solve_radiosity(matrix, reflectance, emission, areas).radiosity
    np.testing.assert_allclose(solution.radiosity, direct, rtol=1e-9)


def test_gauss_seidel_needs_fewer_sweeps_than_jacobi():
    matrix, _, emission, areas = random_system(2)
    sweeps = {
        method: core.solve_radiosity(matrix, 0.8, emission, areas, method, tolerance=1e-8).iterations
        for method in ("jacobi", "gauss_seidel")
    }
    # For such matrices the theory says half, in the limit of many sweeps.
    assert sweeps["gauss_seidel"] < 0.65 * sweeps["jacobi"]


@pytest.mark.parametrize("method", GATHERING)
def test_residuals_are_those_of_the_iterates(method):
    matrix, reflectance, emission, areas = random_system(3)
    iterates = [emission]
    solution = core.solve_radiosity(
        matrix, reflectance, emission, areas, method, callback=lambda state: iterates.append(state.radiosity.copy())
    )
    for iterate, residual in zip(iterates, solution.residuals, strict=True):
        unshot = emission + reflectance * (matrix @ iterate) - iterate
        assert residual == pytest.approx((areas @ np.abs(unshot) / (areas @ emission)).max(), abs=1e-13)
    assert solution.residual == solution.residuals[-1] <= 1e-6 < solution.residuals[-2]


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), factor=st.floats(0, 100))
def test_linearity_and_independence_of_channels(method, seed, factor):
    matrix, reflectance, first, _ = random_system(seed, 12)
    second = np.random.default_rng(seed + 1).random(first.shape)

    def solve(emission):
        return core.solve_radiosity(matrix, reflectance, emission, method=method, tolerance=1e-13).radiosity

    together = solve(first + factor * second)
    np.testing.assert_allclose(together, solve(first) + factor * solve(second), rtol=1e-10)
    for channel in range(3):
        alone = core.solve_radiosity(
            matrix, reflectance[:, channel], first[:, channel], method=method, tolerance=1e-13
        ).radiosity
        np.testing.assert_allclose(alone, solve(first)[:, channel], rtol=1e-10)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_bounds_and_monotony(seed):
    matrix, reflectance, emission, _ = random_system(seed, 12)
    radiosity = core.solve_radiosity(matrix, reflectance, emission).radiosity
    slack = 1e-12 * radiosity.max()
    assert np.all(radiosity >= emission - slack)
    assert np.all(radiosity <= emission.max(axis=0) / (1 - reflectance.max(axis=0)) + slack)
    brighter = reflectance.copy()
    brighter[seed % 12] += 0.05
    assert np.all(core.solve_radiosity(matrix, brighter, emission).radiosity >= radiosity - slack)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("closed", [True, False])
def test_energy_is_kept(method, closed):
    matrix, reflectance, emission, areas = random_system(4, closed=closed)
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, method, tolerance=1e-10)
    balance = core.energy_balance(matrix, areas, reflectance, emission, solution.radiosity)
    assert balance.error < 1e-8
    np.testing.assert_allclose(balance.emitted, areas @ emission)
    assert (np.abs(balance.escaped).max() < 1e-10) == closed
    assert (balance.absorbed_share == pytest.approx(1, abs=1e-8)) == closed


def test_energy_balance_notices_what_is_wrong():
    matrix, reflectance, emission, areas = random_system(5)
    solution = core.solve_radiosity(matrix, reflectance, emission, areas)
    wrong = core.energy_balance(matrix, areas, reflectance, emission, 1.1 * solution.radiosity)
    assert wrong.error == pytest.approx(0.1, rel=1e-6)
    dark = core.energy_balance(matrix, areas, reflectance, 0 * emission, 0 * emission)
    assert dark.error == 0 and dark.absorbed_share == 0


@pytest.mark.parametrize("method", METHODS)
def test_reflectance_zero_gives_emission_bit_for_bit(method):
    matrix, _, emission, _ = random_system(6)
    solution = core.solve_radiosity(matrix, 0.0, emission, method=method)
    assert np.array_equal(solution.radiosity, emission)


@pytest.mark.parametrize("method", METHODS)
def test_no_emitter_gives_darkness(method):
    matrix, reflectance, emission, _ = random_system(7)
    solution = core.solve_radiosity(matrix, reflectance, 0 * emission, method=method)
    assert not solution.radiosity.any() and solution.converged and solution.residual == 0


@pytest.mark.parametrize("method", METHODS)
def test_faint_and_bright_channels_are_equally_right(method):
    matrix, _, _, areas = random_system(8)
    emission = np.tile([1e-8, 1e8, 0.0], (40, 1))
    solution = core.solve_radiosity(matrix, 0.5, emission, areas, method, tolerance=1e-11)
    np.testing.assert_allclose(solution.radiosity, 2 * emission, rtol=1e-9)


@pytest.mark.parametrize("value", [1.2, -0.1])
def test_reflectance_out_of_range_is_clamped_with_a_warning(value):
    with pytest.warns(UserWarning, match="Patch 1 with a reflectance outside 0 to 1: clamped"):
        solution = core.solve_radiosity([[0, 0.5], [0.5, 0]], [0.5, value], [1.0, 0.0])
    same = core.solve_radiosity([[0, 0.5], [0.5, 0]], [0.5, np.clip(value, 0, 1)], [1.0, 0.0])
    assert np.array_equal(solution.radiosity, same.radiosity)
    assert solution.warnings and not same.warnings


def test_light_that_nothing_absorbs_has_no_solution():
    matrix = [[0.0, 1.0], [1.0, 0.0]]
    with pytest.raises(SolverError, match="absorbs nothing"):
        core.solve_radiosity(matrix, 1.0, [1.0, 0.0])
    for method in ITERATIVE:
        solution = core.solve_radiosity(matrix, 1.0, [1.0, 0.0], method=method, max_iterations=50)
        assert not solution.converged and solution.iterations == 50 and solution.ended_by == "max_iterations"
    assert not core.solve_radiosity(matrix, 1.0, [0.0, 0.0]).radiosity.any()


@pytest.mark.parametrize("method", ITERATIVE)
def test_start_from_the_solution_ends_at_once(method):
    matrix, reflectance, emission, _ = random_system(9)
    solution = core.solve_radiosity(matrix, reflectance, emission)
    again = core.solve_radiosity(matrix, reflectance, emission, method=method, start=solution.radiosity)
    assert again.iterations == 0 and again.ended_by == "tolerance"
    if method == "progressive_refinement":
        # It holds what the start misses to a solution, which is rounding here.
        np.testing.assert_allclose(again.radiosity, solution.radiosity, rtol=1e-14)
    else:
        assert np.array_equal(again.radiosity, solution.radiosity)


@pytest.mark.parametrize("method", ITERATIVE)
def test_callback_stops_a_solver(method):
    matrix, reflectance, emission, areas = random_system(10)
    solution = core.solve_radiosity(
        matrix, reflectance, emission, areas, method, tolerance=0, callback=lambda state: state.iteration == 3
    )
    assert solution.iterations == 3 and solution.ended_by == "callback" and not solution.converged


@pytest.mark.parametrize("method", ITERATIVE)
def test_start_from_another_light_reaches_the_solution(method):
    matrix, reflectance, emission, areas = random_system(11)
    before = core.solve_radiosity(matrix, reflectance, 3 * emission[::-1], areas).radiosity
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, method, tolerance=1e-11, start=before)
    np.testing.assert_allclose(
        solution.radiosity, core.solve_radiosity(matrix, reflectance, emission, areas).radiosity, rtol=1e-8
    )


@pytest.mark.parametrize(
    "arguments, reason",
    [
        (([[0, 1]], 0.5, 1.0), "square matrix"),
        (([[0, np.nan], [1, 0]], 0.5, 1.0), "patch 0 are negative or not finite"),
        (([[0, 1], [-1, 0]], 0.5, 1.0), "patch 1 are negative or not finite"),
        (([[0, 1], [1, 0]], [0.5] * 3, 1.0), "Reflectance must be one number"),
        (([[0, 1], [1, 0]], np.ones((2, 2)), np.ones((2, 3))), "2 channels and emission 3"),
        (([[0, 1], [1, 0]], 0.5, 1.0, [1.0]), "Areas must be 2 numbers"),
    ],
)
def test_malformed_systems_are_refused(arguments, reason):
    with pytest.raises(SolverError, match=reason):
        core.solve_radiosity(*arguments)


@pytest.mark.parametrize(
    "choices, reason",
    [
        ({"method": "magic"}, "Unknown solver 'magic': choose auto, direct"),
        ({"tolerance": -1}, "Tolerance"),
        ({"tolerance": np.nan}, "Tolerance"),
        ({"max_iterations": -1}, "Maximum iterations"),
        ({"batch": 2}, "Unknown option 'batch' of solver direct, it has none"),
        ({"method": "gmres", "batch": 2}, "Unknown option 'batch' of solver gmres: choose restart"),
        ({"method": "gmres", "restart": 0}, "remembered by gmres must be 1 or more"),
        ({"method": "progressive_refinement", "batch": 0}, "shoot at once must be 1 or more"),
        ({"method": "progressive_refinement", "absorbed": 1.5}, "absorbed must lie above 0"),
        ({"method": "progressive_refinement", "time_limit": -1}, "Time limit"),
        ({"emission": [np.nan, 0.0]}, "Emission of patch 0"),
        ({"reflectance": [0.5, np.nan]}, "Reflectance of patch 1 is not a number"),
    ],
)
def test_unusable_settings_are_refused(choices, reason):
    with pytest.raises(SettingsError, match=reason):
        core.solve_radiosity(**{"form_factors": np.zeros((2, 2)), "reflectance": 0.5, "emission": 1.0} | choices)
