"""Two levels: the published case, what averaging keeps, and the entrance by name."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.hierarchy import SubdivisionLimits
from radiosity.core.errors import SceneTooLargeError, SettingsError, SolverError
from radiosity.core.solvers import SOLVERS, ElementFactors, solve_two_level

from benchmarks.solver_scenes import SCENES
from tests.core.solvers.systems import random_system
from tests.reference_cases import form_factor_cases, polygons_of, solution_cases

CASE = solution_cases()["twolevel-cube"]
ROOM = form_factor_cases()["enc-cube"]
NAMES = [surface["name"] for surface in ROOM["surfaces"]]
COARSE = SubdivisionLimits(patch_max=500, patch_min=200, element_max=250, element_min=100)


def cube():
    polygons, _ = polygons_of(ROOM)
    reflectance, emission = (
        np.array([case[name] for name in NAMES]) for case in (CASE["reflectance"], CASE["emission"])
    )
    return core.Environment.from_polygons(polygons, reflectance, emission)


def coarse_factors(seed, parts=4, channels=3):
    """A random system of elements, and the same one seen by patches of `parts` elements each."""
    matrix, _, _, areas = random_system(seed, 40)
    patches = np.arange(40) // parts
    summed = matrix @ (patches[:, None] == np.arange(40 // parts))
    generator = np.random.default_rng(seed)
    return ElementFactors(summed, patches, areas), *generator.random((2, 40 // parts, channels))


def test_published_elements_of_a_floor():
    # Patches are the sides; elements are a sixteenth of them.
    limits = SubdivisionLimits(patch_max=2000, patch_min=2000, element_max=500, element_min=500)
    solution = core.solve(cube(), method="two_level", limits=limits, accuracy=1e-6)
    np.testing.assert_allclose(
        solution.radiosity[:, 0], [CASE["expected"]["B_patches"][name] for name in NAMES], rtol=1e-9
    )
    hierarchy = solution.hierarchy
    assert len(hierarchy.elements) == 96 == solution.rows
    floor = np.flatnonzero(hierarchy.surfaces[hierarchy.elements] == NAMES.index("floor"))
    places = np.floor(hierarchy.corners[hierarchy.elements[floor]].mean(axis=1)[:, :2] * 4).astype(int)
    found = dict(zip(map(tuple, places.tolist()), solution.elements[floor, 0], strict=True))
    assert len(found) == 16
    for element in CASE["expected"]["floor_elements"]:
        assert found[element["i"], element["j"]] == pytest.approx(element["B"], rel=1e-9)


def test_elements_as_arrays():
    matrix = np.array(CASE["F"])
    emission, reflectance = (np.array([CASE[key][name] for name in NAMES]) for key in ("emission", "reflectance"))
    solution = solve_two_level(ElementFactors(matrix, np.arange(6), np.ones(6)), reflectance, emission, "direct")
    np.testing.assert_allclose(solution.elements, solution.radiosity, rtol=1e-14)
    assert solution.elements.shape == (6,)


@pytest.mark.parametrize("solver", [*SOLVERS, "auto"])
def test_mean_over_the_elements_of_a_patch_is_the_patch(solver):
    factors, reflectance, emission = coarse_factors(1)
    solution = solve_two_level(factors, 0.9 * reflectance, emission, solver, tolerance=1e-13)
    means = np.stack([np.bincount(factors.patches, factors.areas * column) for column in solution.elements.T], axis=1)
    np.testing.assert_allclose(means / factors.patch_areas()[:, None], solution.radiosity, rtol=1e-11)
    # Elements of a patch differ: it is not the patch that is handed down.
    assert np.ptp(solution.elements[:4], axis=0).min() > 0.001


def test_patch_factors_are_area_averages():
    factors, _, _ = coarse_factors(2)
    for patch in range(10):
        mine = factors.patches == patch
        mean = np.average(factors.matrix[mine], axis=0, weights=factors.areas[mine])
        np.testing.assert_allclose(factors.patch_matrix()[patch], mean, rtol=1e-14)


@pytest.mark.parametrize("closed", [True, False])
def test_repair_mends_both_identities_and_keeps_proportions(closed):
    factors, _, _ = coarse_factors(3)
    noise = np.random.default_rng(3).normal(1, 0.05, factors.matrix.shape)
    noisy = ElementFactors((1 if closed else 0.7) * noise * factors.matrix, factors.patches, factors.areas)
    mended = noisy.repaired(closed)
    exchange = mended.patch_areas()[:, None] * mended.patch_matrix()
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-15 * exchange.max(), rtol=1e-12)
    if closed:
        np.testing.assert_allclose(mended.patch_matrix().sum(axis=1), 1, rtol=1e-12)
    gain = mended.matrix / noisy.matrix
    np.testing.assert_allclose(gain, gain[::4][factors.patches], rtol=1e-12)


def test_repair_gives_elements_what_only_the_other_end_has_seen():
    # Patch 1 has seen patch 0, whose two elements have missed it.
    matrix = np.array([[0, 0, 0.9], [0, 0, 0.9], [0.1, 0, 0.8], [0.9, 0.1, 0]])
    mended = ElementFactors(matrix, np.array([0, 0, 1, 2]), np.array([0.5, 0.5, 1, 1])).repaired(closed=True)
    np.testing.assert_allclose(mended.matrix.sum(axis=1), 1, rtol=1e-12)
    assert mended.matrix[0, 1] == mended.matrix[1, 1] > 0


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("method", ["two_level", "adaptive"])
def test_power_is_kept_whatever_the_accuracy(name, method):
    choices = {"error": 0.3} if method == "adaptive" else {}
    environment = SCENES[name]()
    solution = core.solve(environment, method=method, limits=COARSE, accuracy=0.02, tolerance=1e-9, **choices)
    hierarchy, factors = solution.hierarchy, solution.factors
    patches = hierarchy.polygons(hierarchy.patch_nodes)
    balance = core.energy_balance(
        factors.patch_matrix(), patches.areas, patches.reflectance, patches.emission, solution.radiosity
    )
    assert balance.error < 1e-8
    # The elements emit and absorb what the patches do.
    assert factors.areas @ solution.elements == pytest.approx(patches.areas @ solution.radiosity, rel=1e-7)


def test_elements_as_patches_are_the_whole_matrix():
    environment = cube()
    limits = SubdivisionLimits(patch_max=500, patch_min=500, element_max=500, element_min=500)
    solution = core.solve(environment, method="two_level", limits=limits, tolerance=1e-12)
    cells = solution.hierarchy.polygons(solution.hierarchy.patch_nodes)
    assert len(cells) == 96
    whole = core.solve(cells, core.form_factors(cells), method="direct")
    # Both are exact here, but for the repair of the quadrature's last digits.
    np.testing.assert_allclose(solution.elements, whole.radiosity, rtol=1e-6)
    np.testing.assert_allclose(solution.radiosity, whole.radiosity, rtol=1e-6)


@pytest.mark.parametrize("sides", [6, 5])
def test_no_light_is_lost_in_closed_rooms_only(sides):
    # Sampled rows: those of a closed room are made to sum to 1 on the mean over a patch; those of an open one are not.
    room = cube()
    part = core.Environment.from_polygons(room.polygons[:sides], room.reflectance[:sides], room.emission[:sides])
    solution = core.solve(part, method="two_level", limits=COARSE, accuracy=0.02, factor_method="hemisphere")
    sums = solution.factors.patch_matrix().sum(axis=1)
    if sides == 6:
        np.testing.assert_allclose(sums, 1, rtol=1e-10)
    else:
        # The side that is missing is a fifth of what each of the others sees.
        assert 1 - sums @ solution.factors.patch_areas() / sides == pytest.approx(0.2, abs=0.02)


def test_sheets_count_both_sides():
    # A sheet between a glowing floor and a dark ceiling, and nothing else: both sides share what the lower receives.
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    polygons = [square, square + np.array([0, 0, 0.5]), square[::-1] + np.array([0, 0, 1])]
    environment = core.Environment.from_polygons(polygons, [0.2, 0.8, 0.4], [1.0, 0.0, 0.0], [False, True, False])
    limits = SubdivisionLimits(patch_max=1000, patch_min=1000, element_max=500, element_min=500)
    solution = core.solve(environment, method="two_level", limits=limits, accuracy=3e-3)
    patches = solution.hierarchy.polygons(solution.hierarchy.patch_nodes)
    np.testing.assert_allclose(solution.factors.patch_areas(), patches.areas, rtol=1e-12)
    whole = core.solve(patches, core.form_factors(patches, accuracy=3e-3))
    # Three standard errors of the factors that light the sheet, in parts of the half of a view that each side has.
    np.testing.assert_allclose(solution.radiosity, whole.radiosity, rtol=0.04)


def test_finer_elements_change_no_patch_much_and_cost_no_larger_system():
    environment = SCENES["two_rooms"]()
    coarse, fine = (
        core.solve(environment, method="two_level", accuracy=3e-3,
                   limits=SubdivisionLimits(400, 200, element_max, 50))
        for element_max in (400, 100)
    )  # fmt: skip
    assert len(fine.radiosity) == len(coarse.radiosity)
    assert len(fine.elements) > 8 * len(coarse.elements)
    areas = fine.factors.patch_areas()
    difference = areas @ np.abs(fine.radiosity - coarse.radiosity) / (areas @ coarse.radiosity)
    # Three standard errors of 3e-3 in factors of which each patch has some ten that matter.
    assert difference.max() < 0.03


def test_too_many_patches_are_refused():
    with pytest.raises(SceneTooLargeError, match="more than max_elements, 100"):
        limits = SubdivisionLimits(patch_min=1, patch_max=20, max_elements=100)
        core.solve(cube(), method="two_level", limits=limits)


def test_methods_that_know_patches_only_are_refused():
    with pytest.raises(SettingsError, match="Rows of elements do not exist by disk"):
        core.solve(cube(), method="two_level", limits=COARSE, accuracy=0.1, factor_method="disk")


@pytest.mark.parametrize(
    "choices, reason",
    [
        ({"method": "gmres"}, "Solver 'gmres' needs form factors"),
        ({}, "Solver 'auto' needs form factors"),
        ({"method": "magic"}, "choose auto, direct, .*two_level, adaptive"),
        ({"method": "two_level", "form_factors": np.zeros((6, 6))}, "makes its own patches"),
        ({"method": "two_level", "start": np.zeros((6, 3))}, "makes its own patches"),
        ({"method": "two_level", "solver": "magic"}, "Unknown solver 'magic'"),
        ({"method": "two_level", "accuracy": 2}, "Accuracy of form factors"),
        ({"method": "two_level", "limits": COARSE, "tolerance": -1}, "Tolerance"),
        ({"method": "two_level", "solver": "direct", "batch": 2}, "Unknown option 'batch'"),
        ({"method": "adaptive", "error": 0}, "Error between neighbors must be above 0"),
    ],
)
def test_what_does_not_suit_is_refused(choices, reason):
    with pytest.raises(SettingsError, match=reason):
        core.solve(cube(), **choices)


@pytest.mark.parametrize(
    "arrays, reason",
    [
        ((np.zeros(3), np.zeros(3, dtype=int), np.ones(3)), "must be"),
        ((np.zeros((3, 2)), np.zeros(2, dtype=int), np.ones(3)), "must be"),
        ((np.zeros((3, 2)), np.zeros(3, dtype=int), np.ones(3)), "Each of the 2 patches needs an element"),
        ((np.zeros((3, 2)), np.array([0, 1, 2]), np.ones(3)), "Each of the 2 patches needs an element"),
    ],
)
def test_malformed_factors_are_refused(arrays, reason):
    with pytest.raises(SolverError, match=reason):
        ElementFactors(*arrays)
