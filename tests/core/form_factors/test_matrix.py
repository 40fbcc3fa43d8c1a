"""Form factors of environments and pairs: published values, identities, and honest errors."""

from itertools import pairwise

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SceneTooLargeError, SettingsError
from radiosity.core.form_factors import matrix

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
ENCLOSURES = ids(CASES, "enclosure")
FAST_ENCLOSURES = ("enc-cube", "enc-tetra", "enc-L-room", "enc-two-sealed-cubes", "enc-ward-room")
# One polygon to one polygon with nothing in between; obs-shapiro lists its two-sided plate as radiating faces.
FREE_PAIRS = ids(CASES, "polygon-polygon", "extreme")
OBSTRUCTED = ids(CASES, "obstructed")
FAST_OBSTRUCTED = ("obs-full", "obs-fin", "obs-two-disjoint", "obs-grazing-none", "obs-near-emitter")
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
UP = np.array([0.0, 0, 1])
ABOVE = SQUARE[::-1] + UP  # looks down on SQUARE
OPPOSED = 0.19982489569838738  # ff-par-1-1-1


def slow_unless(names, fast):
    return [name if name in fast else pytest.param(name, marks=pytest.mark.slow) for name in names]


def pair_values(case, **choices):
    """(computed, expected) for each single pair of a case; all its other surfaces block."""
    surfaces = {surface["name"]: surface["polygons"] for surface in case["surfaces"]}
    for expected in case["expected"]:
        ends = (expected["from"], expected["to"])
        blockers = [polygon for name, polygons in surfaces.items() if name not in ends for polygon in polygons]
        yield core.form_factor(*(surfaces[end][0] for end in ends), blockers, **choices), expected["F"]


def fine_environment(count=6):
    """A closed box of count x count patches a side: enough rows to say something about errors."""
    lines = np.linspace(0, 1, count + 1)
    polygons = []
    for axis in range(3):
        for side in (0.0, 1.0):
            for low, high in pairwise(lines):
                for left, right in pairwise(lines):
                    loop = np.zeros((4, 3))
                    loop[:, axis] = side
                    loop[:, (axis + 1) % 3] = [low, high, high, low]
                    loop[:, (axis + 2) % 3] = [left, left, right, right]
                    polygons.append(loop if side == 0 else loop[::-1])
    return core.Environment.from_polygons(polygons)


# Single pairs


@pytest.mark.parametrize("name", FREE_PAIRS)
def test_unoccluded_pair_at_the_fine_level(name):
    case = CASES[name]
    for value, expected in pair_values(case, accuracy=1e-6):
        assert abs(value - expected) <= allowed(case, "fine", expected)
        assert abs(value - expected) <= 1e-4 * max(expected, 0.02)


@pytest.mark.parametrize("name", slow_unless(OBSTRUCTED, FAST_OBSTRUCTED))
def test_obstructed_pair_at_the_coarse_level(name):
    case = CASES[name]
    # A fifth of the absolute tolerance, or of the relative one where that is wider: five standard errors.
    for value, expected in pair_values(case, accuracy=1e-3):
        assert abs(value - expected) <= max(allowed(case, "coarse", expected), 4e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", OBSTRUCTED)
def test_obstructed_pair_at_high_accuracy(name):
    for value, expected in pair_values(CASES[name], accuracy=2e-4):
        assert abs(value - expected) <= 1e-3


@pytest.mark.parametrize("method", ["point_to_polygon", "hemisphere"])
def test_methods_agree_on_a_pair_and_its_reverse(method):
    forward = core.form_factor(SQUARE, ABOVE, method=method)
    # Four standard errors of the default accuracy.
    assert forward == pytest.approx(OPPOSED, abs=4e-3)
    wide = ABOVE * [2, 1, 1]
    assert core.form_factor(SQUARE, wide, method=method) == pytest.approx(
        2 * core.form_factor(wide, SQUARE, method=method), abs=8e-3
    )


def test_configuration_factor_is_halved_by_a_screen_over_half_the_view():
    # Seen from below the middle, a wall up to the ceiling hides exactly one half of a symmetric light.
    wall = np.array([[0.5, -5, 0.001], [5, -5, 0.001], [5, 5, 0.001], [0.5, 5, 0.001]])
    free = core.configuration_factor([0.5, 0.5, 0], [0, 0, 2], ABOVE)
    assert free == pytest.approx(0.2394564704607735, rel=1e-12)  # rule-disk-opposed-centre
    half = core.configuration_factor([0.5, 0.5, 0], [0, 0, 1], ABOVE, blockers=[wall], accuracy=5e-4)
    assert half == pytest.approx(free / 2, abs=2e-3)
    everything = [[-5, -5, 0.5], [5, -5, 0.5], [5, 5, 0.5], [-5, 5, 0.5]]
    assert core.configuration_factor([0.5, 0.5, 0], [0, 0, 1], ABOVE, blockers=[everything]) == 0


# Matrices


@pytest.mark.parametrize("name", slow_unless(ENCLOSURES, FAST_ENCLOSURES))
def test_enclosure_at_the_coarse_level(name):
    case = CASES[name]
    order, expected = case["matrix"]["order"], np.array(case["matrix"]["F"])
    result, _, info = surface_matrix(case, accuracy=5e-4)
    result = in_order(case, result, order)
    assert np.all(np.abs(result - expected) <= allowed(case, "coarse", expected))
    assert info.closed == (np.abs(expected.sum(axis=1) - 1).max() < 1e-6)
    # A surface of several polygons averages them, so that its error is no larger.
    assert np.abs(result - expected).max() < 5 * info.estimated_error
    if info.closed:
        np.testing.assert_allclose(result.sum(axis=1), 1, atol=1e-12)
    # What cannot see each other exchanges exactly nothing, however often it was tried.
    assert not result[expected == 0].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["enc-cube", "enc-tetra", "enc-L-room", "enc-two-sealed-cubes"])
def test_enclosure_at_the_fine_level(name):
    case = CASES[name]
    expected = np.array(case["matrix"]["F"])
    result = in_order(case, surface_matrix(case, accuracy=1e-4)[0], case["matrix"]["order"])
    assert np.all(np.abs(result - expected) <= allowed(case, "fine", expected))


@pytest.mark.parametrize("method, visibility", [("hemisphere", "embree"), ("point_to_polygon", "embree")])
def test_every_method_meets_a_plate_in_a_box(method, visibility):
    case = CASES["enc-facet-8"]
    expected = np.array(case["matrix"]["F"])
    result, _, info = surface_matrix(case, method=method, visibility=visibility, accuracy=8e-3)
    assert np.abs(in_order(case, result, case["matrix"]["order"]) - expected).max() < 5 * 8e-3
    assert info.method_counts == {method: 8} and info.rays > 0


def test_without_visibility_a_convex_room_is_exact_in_its_row_sums():
    case = CASES["enc-cube"]
    result, _, info = surface_matrix(case, method="point_to_polygon", visibility="none", accuracy=1e-4)
    assert info.rays == 0 and info.closed and info.raw_closure_error < 1e-12
    assert np.abs(in_order(case, result, case["matrix"]["order"]) - np.array(case["matrix"]["F"])).max() < 5e-4


def test_identities_hold_in_the_matrix_that_is_returned():
    environment = fine_environment(3)
    result = core.form_factors(environment, "hemisphere", accuracy=5e-3)
    assert result.closed
    exchange = environment.areas[:, None] * result.matrix
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-15)
    np.testing.assert_allclose(result.matrix.sum(axis=1), 1, atol=1e-12)
    assert result.matrix.min() >= 0 and not result.matrix.diagonal().any()
    assert result.reciprocity_error < 1e-14 and result.closure_error < 1e-12
    assert 0 < result.raw_reciprocity_error < 0.05
    assert result.estimated_error <= 5e-3


def test_error_estimate_is_true_and_falls_with_the_accuracy_asked_for():
    case = CASES["enc-box-5-4-3"]
    expected = np.array(case["matrix"]["F"])
    polygons, _ = polygons_of(case)
    environment = core.Environment.from_polygons(polygons)
    deviations = {}
    for accuracy in (8e-3, 4e-3, 2e-3):
        runs = [core.form_factors(environment, "hemisphere", accuracy=accuracy, seed=seed) for seed in range(6)]
        assert all(run.estimated_error <= accuracy for run in runs)
        errors = np.array([in_order(case, run.matrix, case["matrix"]["order"]) - expected for run in runs])
        deviations[accuracy] = np.sqrt((errors**2).mean(axis=0)).max()
        # The worst of 30 factors in 6 runs, each estimate itself good to a quarter.
        assert deviations[accuracy] < 1.5 * accuracy
    assert deviations[2e-3] < 0.5 * deviations[8e-3]


def test_same_seed_same_bits_for_any_number_of_threads():
    environment = fine_environment(2)
    first = core.form_factors(environment, "hemisphere", accuracy=4e-3, seed=3, threads=1)
    again = core.form_factors(environment, "hemisphere", accuracy=4e-3, seed=3, threads=3)
    other = core.form_factors(environment, "hemisphere", accuracy=4e-3, seed=4)
    assert np.array_equal(first.matrix, again.matrix)
    assert not np.array_equal(first.matrix, other.matrix)


@pytest.mark.parametrize("scale, shift", [(1e-5, 0), (1e5, 0), (1, 1e5)])
def test_scale_and_place_do_not_matter(scale, shift):
    polygons, _ = polygons_of(CASES["enc-L-room"])
    here, there = (
        core.form_factors(core.Environment.from_polygons(loops), accuracy=2e-3).matrix
        for loops in (polygons, [loop * scale + shift for loop in polygons])
    )
    # The same rays meet the same faces but for some at edges, of about 1e5 a row.
    np.testing.assert_allclose(there, here, atol=2e-4)


def test_back_to_back_faces_are_met_on_the_side_they_face():
    plate = SQUARE * 0.5 + [0.25, 0.25, 0.75]
    environment = core.Environment.from_polygons([SQUARE, ABOVE, plate[::-1], plate])
    result = core.form_factors(environment, accuracy=1e-3).matrix
    assert result[2, 3] == result[3, 2] == result[0, 3] == result[1, 2] == 0
    # obs-shapiro
    assert result[2, 0] == pytest.approx(0.33681717426388946, abs=4e-3)
    assert result[3, 1] == pytest.approx(0.7944527232521175, abs=4e-3)


def test_two_sided_patch_radiates_from_both_sides():
    middle = SQUARE + 0.5 * UP
    one_sided = core.Environment.from_polygons([SQUARE, middle[::-1], middle, ABOVE])
    two_sided = core.Environment.from_polygons([SQUARE, middle, ABOVE], two_sided=[False, True, False])
    apart, joined = (core.form_factors(e, accuracy=1e-3).matrix for e in (one_sided, two_sided))
    assert joined[0, 1] == pytest.approx(apart[0, 1], abs=4e-3)
    # Half of what the sheet sends leaves from either side.
    assert joined[1, 0] == pytest.approx(apart[1, 0] / 2, abs=4e-3)
    assert joined[1, 2] == pytest.approx(apart[2, 3] / 2, abs=4e-3)
    assert joined[0, 2] == 0 and joined[1, 1] == 0


def test_single_patch_sees_nothing():
    result = core.form_factors(core.Environment.from_polygons([SQUARE]))
    assert result.matrix.tolist() == [[0.0]] and result.escaped.tolist() == [1.0] and not result.closed


@pytest.mark.parametrize("name", ids(CASES, "degenerate"))
def test_degenerate_polygon_leaves_the_others_as_they_are(name):
    case = CASES[name]
    polygons, _ = polygons_of(case)
    names = [surface["name"] for surface in case["surfaces"]]
    try:
        with np.testing.suppress_warnings() as warnings:
            warnings.filter(UserWarning)
            environment = core.Environment.from_polygons(polygons)
    except core.InvalidPolygonError as error:
        assert f"Polygon {names.index('Z')}" in str(error)
        return
    result = core.form_factors(environment, accuracy=1e-3).matrix
    assert np.isfinite(result).all() and result.min() >= 0 and result.sum(axis=1).max() <= 1 + 1e-6
    for expected in case["behaviour"]["unaffected"]:
        pair = names.index(expected["from"]), names.index(expected["to"])
        assert result[pair] == pytest.approx(expected["F"], abs=4e-3)
        assert core.form_factor(*(polygons[row] for row in pair), accuracy=1e-7) == pytest.approx(
            expected["F"], abs=expected["tol"]
        )


def test_all_degenerate_patches_exchange_nothing():
    with pytest.warns(UserWarning, match="without area"):
        environment = core.Environment.from_polygons([SQUARE * [1, 0, 0]])
    result = core.form_factors(environment)
    assert result.matrix.tolist() == [[0.0]] and result.rays == 0


@pytest.mark.parametrize(
    "choices, reason",
    [
        ({"method": "magic"}, "Unknown form-factor method 'magic': choose auto, hemisphere"),
        ({"visibility": "magic"}, "Visibility 'magic' does not exist for hemisphere"),
        ({"method": "hemisphere", "visibility": "none"}, "choose auto, embree"),
        ({"resolution": 64}, "Unknown option 'resolution' of method hemisphere"),
        ({"accuracy": 0}, "Accuracy"),
        ({"accuracy": float("nan")}, "Accuracy"),
    ],
)
def test_unknown_choices_are_refused_with_what_exists(choices, reason):
    with pytest.raises(SettingsError, match=reason):
        core.form_factors(core.Environment.from_polygons([SQUARE, ABOVE]), **choices)


def test_unknown_choices_for_pairs_are_refused():
    with pytest.raises(SettingsError, match="Unknown form-factor method"):
        core.form_factor(SQUARE, ABOVE, method="magic")
    with pytest.raises(SettingsError, match="Unknown form-factor method"):
        core.configuration_factor([0, 0, 0], [0, 0, 1], ABOVE, method="hemisphere")
    with pytest.raises(SettingsError, match="Point and normal"):
        core.configuration_factor([0, 0, 0], [0, 0, 0], ABOVE)


def test_a_matrix_that_would_not_fit_is_refused_with_numbers(monkeypatch):
    monkeypatch.setattr(matrix, "LARGEST_MATRIX", 3)
    with pytest.raises(SceneTooLargeError, match=r"2 patches need a matrix of .* GiB"):
        core.form_factors(core.Environment.from_polygons([SQUARE, ABOVE]))
