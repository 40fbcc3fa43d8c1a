"""All solvers and strategies agree with the direct one on lit rooms, within their residuals and accuracies."""

from functools import cache

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import Hierarchy, SubdivisionLimits
from radiosity.core.form_factors.rows_on_demand import rows_on_demand
from radiosity.core.solvers import SOLVERS
from radiosity.core.solvers.strategies import DIVISIONS, LOCAL_ENVIRONMENTS
from radiosity.core.solvers.transparent_boundary import relative_error

from benchmarks.solver_scenes import SCENES

#: Some hundred patches in each scene; elements are as large, or of half that size.
LIMITS = SubdivisionLimits(patch_max=400, patch_min=200, element_max=400, element_min=100)
ACCURACY = 3e-3


@cache
def room(name, seed=0):
    """A scene's patches, the form factors between them, and the direct solution."""
    hierarchy = Hierarchy.build(SCENES[name](), LIMITS)
    patches = hierarchy.polygons(hierarchy.patch_nodes)
    factors = core.form_factors(patches, accuracy=ACCURACY, seed=seed)
    return hierarchy, patches, factors, core.solve(patches, factors, method="direct")


def agrees(name, radiosity):
    """Whether a solution is as near to the direct one as that is to itself with other rays, give or take as much."""
    _, patches, _, direct = room(name)
    noise = distances(patches.areas, room(name, seed=1)[-1].radiosity, direct.radiosity)
    return np.all(distances(patches.areas, radiosity, direct.radiosity) < 2 * noise)


def distances(areas, radiosity, expected):
    """Mean differences over mean radiosity, by area, of each channel."""
    return areas @ np.abs(radiosity - expected) / (areas @ expected)


@pytest.mark.parametrize("method", SOLVERS)
@pytest.mark.parametrize("name", SCENES)
def test_solvers_of_a_matrix_agree_with_the_direct_one(name, method):
    _, patches, factors, direct = room(name)
    solution = core.solve(patches, factors, method=method, tolerance=1e-7)
    assert solution.converged and solution.residual <= 1e-7
    # Power that is left over is reflected at most 1 / (1 - rho) times on: factors are reciprocal.
    left = solution.residual * (patches.areas @ patches.emission) / (1 - patches.reflectance.max(axis=0))
    rounding = 1e-13 * (patches.areas @ direct.radiosity)
    assert np.all(patches.areas @ np.abs(solution.radiosity - direct.radiosity) <= left + rounding)
    balance = core.energy_balance(
        factors.matrix, patches.areas, patches.reflectance, patches.emission, solution.radiosity
    )
    assert balance.error < 1e-6


@pytest.mark.parametrize("name", SCENES)
def test_progressive_refinement_of_rows_agrees_with_that_of_the_matrix(name):
    _, patches, _, _ = room(name)
    rows = rows_on_demand(patches, accuracy=ACCURACY)
    solution = core.solve(patches, rows, tolerance=1e-4)
    assert solution.method == "progressive_refinement" and solution.converged
    assert agrees(name, solution.radiosity)


@pytest.mark.parametrize("strategy", DIVISIONS)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", SCENES)
def test_solvers_inside_strategies_agree_with_the_direct_one(name, solver, strategy):
    choices = {"error": 1.0} if strategy == "adaptive" else {}
    solution, direct = (
        core.solve(SCENES[name](), method=strategy, limits=LIMITS, accuracy=0.1, solver=each, tolerance=1e-7, **choices)
        for each in (solver, "direct")
    )
    np.testing.assert_array_equal(solution.hierarchy.corners, direct.hierarchy.corners)
    areas = direct.factors.areas
    assert solution.converged
    # A residual of 1e-7 of the emitted power, of which reflectances up to 0.75 make four times as much.
    assert distances(areas, solution.elements, direct.elements).max() < 1e-6


@pytest.mark.parametrize("strategy", DIVISIONS)
@pytest.mark.parametrize("name", SCENES)
def test_strategies_agree_with_the_whole_matrix(name, strategy):
    hierarchy, patches, _, _ = room(name)
    choices = {"error": 0.3} if strategy == "adaptive" else {}
    solution = core.solve(hierarchy.environment, method=strategy, limits=LIMITS, accuracy=ACCURACY, **choices)
    np.testing.assert_array_equal(
        solution.hierarchy.corners[solution.hierarchy.patch_nodes], hierarchy.corners[hierarchy.patch_nodes]
    )
    assert agrees(name, solution.radiosity)
    factors = solution.factors
    balance = core.energy_balance(
        factors.patch_matrix(), patches.areas, patches.reflectance, patches.emission, solution.radiosity
    )
    assert balance.error < 1e-6


@pytest.mark.parametrize("strategy", LOCAL_ENVIRONMENTS)
@pytest.mark.parametrize("name", SCENES)
def test_local_environments_agree_with_the_whole_matrix(name, strategy):
    _, patches, _, direct = room(name)
    solution = core.solve(patches, method=strategy, accuracy=ACCURACY, tolerance=1e-7)
    assert solution.converged
    differences = np.abs(solution.radiosity - direct.radiosity)
    # The direct solution has noise of its own, as another seed shows.
    noise = np.abs(room(name, seed=1)[-1].radiosity - direct.radiosity)
    assert relative_error(patches, differences, direct.radiosity) < solution.estimated_error + relative_error(
        patches, noise, direct.radiosity
    )
