"""Analytic factors with item buffers or rays for visibility, against published values among blockers."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.cells import Cells
from radiosity.core.form_factors.hybrid import hybrid_rows, piece_factors
from radiosity.core.form_factors.point_to_polygon import point_to_polygon

from tests.reference_cases import allowed, form_factor_cases, in_order, surface_matrix

CASES = form_factor_cases()
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
CONVEX = ["enc-cube", "enc-tetra", "enc-ward-room", "obs-grazing-none"]
BLOCKED = ["obs-v3d-square", "obs-full", "obs-fin", "obs-two-disjoint", "obs-centre-mid", "enc-box345-1cube"]


def deviations(name, level, **choices):
    """Deviations over what the level allows, and the result."""
    case = CASES[name]
    matrix, _, result = surface_matrix(case, method="hybrid", **choices)
    names = [surface["name"] for surface in case["surfaces"]]
    found = []
    for expected in case.get("expected", ()):
        ends = expected["to"] if isinstance(expected["to"], list) else [expected["to"]]
        value = sum(matrix[names.index(expected["from"]), names.index(end)] for end in ends)
        found.append(abs(value - expected["F"]) / allowed(case, level, expected["F"]))
    if case.get("matrix"):
        wanted = np.array(case["matrix"]["F"])
        difference = np.abs(in_order(case, matrix, case["matrix"]["order"]) - wanted)
        found.extend((difference / allowed(case, level, wanted)).ravel())
    return np.array(found), result


@pytest.mark.parametrize("name", CONVEX)
def test_unblocked_pairs_are_exact_and_cost_no_test(name):
    found, result = deviations(name, "exact")
    assert found.max() <= 1
    assert result.rays == 0


@pytest.mark.parametrize("name", BLOCKED)
def test_blocked_pairs_by_rays(name):
    found, result = deviations(name, "fine", accuracy=1e-3, detection="rays")
    assert found.max() <= 1
    assert result.rays > 0


@pytest.mark.parametrize("name", ["obs-full", "obs-fin", "obs-fin-full"])
def test_blocked_pairs_by_item_buffers(name):
    found, _ = deviations(name, "fine", accuracy=3e-3, detection="item_buffer")
    assert found.max() <= 1


@pytest.mark.parametrize("polygon", [SQUARE, SQUARE[:3]], ids=["square", "triangle"])
def test_closed_form_of_pieces_is_that_of_polygons(polygon):
    generator = np.random.default_rng(31)
    points = generator.uniform(-1, 2, (200, 3))
    normals = generator.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cells = Cells.of(core.Environment.from_polygons([polygon]))
    values = piece_factors(points, normals, cells[np.zeros(200, int)])
    wanted = point_to_polygon(points, normals, polygon)
    np.testing.assert_allclose(values, wanted, atol=1e-12)
    assert (values > 0).sum() > 50


def test_bright_sources_are_cut_further():
    polygons = [SQUARE, (SQUARE * 0.3 + [0.2, 0.2, 8])[::-1], SQUARE * 0.5 + [0.4, 0.4, 4]]
    dark = core.Environment.from_polygons(polygons)
    lit = core.Environment.from_polygons(polygons, emission=[0, 100, 0])
    tests = [hybrid_rows(environment, "embree", 0.1).rays for environment in (dark, lit)]
    assert tests[0] < tests[1]


def test_unknown_detection_is_refused():
    with pytest.raises(SettingsError, match="item_buffer, rays"):
        core.form_factors(core.Environment.from_polygons([SQUARE]), method="hybrid", detection="guess")


def test_patches_without_area_exchange_nothing():
    line = np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1]], float)
    with pytest.warns(UserWarning, match="without area"):
        environment = core.Environment.from_polygons([SQUARE, line, SQUARE[::-1] + np.array([0, 0, 1.0])])
    matrix = core.form_factors(environment, method="hybrid").matrix
    assert matrix[0, 2] == pytest.approx(0.19982489569838738, abs=1e-12)
    assert not matrix[1].any() and not matrix[:, 1].any()


@pytest.mark.parametrize("method", ["contour_integral", "hybrid", "disk"])
def test_single_pair_with_and_without_a_blocker(method):
    roof, plate = SQUARE[::-1] + np.array([0, 0, 1.0]), SQUARE * 2 - np.array([0.5, 0.5, -0.5])
    free = core.form_factor(SQUARE, roof, method=method, accuracy=1e-2)
    assert free == pytest.approx(0.19982489569838738, abs=1e-12 if method != "disk" else 1e-2)
    assert core.form_factor(SQUARE, roof, blockers=[plate], method=method, accuracy=1e-2) == 0
