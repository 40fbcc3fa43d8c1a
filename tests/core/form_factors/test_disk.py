"""Ray-traced disks against the published rule, their own error bound, and factors between patches."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.cells import Cells
from radiosity.core.form_factors.contour_integral import contour_integral
from radiosity.core.form_factors.disk import adaptive_disk_factor, disk_factor, disk_rows
from radiosity.core.form_factors.point_to_polygon import point_to_polygon

from tests.reference_cases import allowed, form_factor_cases, polygons_of, surface_matrix

CASES = form_factor_cases()
RULES = [name for name in CASES if name.startswith("rule-disk")]
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
FLOOR_AND_WALL = [SQUARE, np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], dtype=float)]
ARROW = np.array([[0, 0, 0], [2, 1, 0], [1, 0, 0], [2, -1, 0]], dtype=float)[::-1]


def patch_of(setup):
    origin, u, v = (np.array(setup["patch"][key], float) for key in ("origin", "u", "v"))
    loop = np.array([origin, origin + u, origin + u + v, origin + v])
    return loop if np.cross(u, v) @ setup["patch"]["normal"] > 0 else loop[::-1]


@pytest.mark.parametrize("name", RULES)
def test_published_rule(name):
    setup = CASES[name]["setup"]
    for value in CASES[name]["values"]:
        found = disk_factor(setup["point"], setup["normal"], patch_of(setup), value["n"])
        assert found == pytest.approx(value["F"], abs=1e-9)


@pytest.mark.parametrize("polygon", [SQUARE, SQUARE[:3], ARROW], ids=["square", "triangle", "concave"])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
def test_adaptive_error_stays_within_its_bound(polygon, accuracy):
    generator = np.random.default_rng(21)
    used = []
    for _ in range(60):
        point = np.append(generator.uniform(-1, 2, 2), 10 ** generator.uniform(-1.5, 1))
        normal = generator.normal(size=3)
        normal /= np.linalg.norm(normal)
        factor, bound, samples = adaptive_disk_factor(point, normal, polygon, accuracy)
        exact = point_to_polygon(point[None], normal[None], polygon)[0]
        assert abs(factor - exact) <= bound + 1e-12
        assert bound <= 2 * accuracy
        used.append(samples)
    # Far points take a single disk, near ones many.
    assert min(used) <= 2 and max(used) > 100


def test_error_falls_as_one_over_samples():
    point, normal = np.array([0.3, 0.4, 1.0]), np.array([0, 0.0, -1.0])
    exact = point_to_polygon(point[None], normal[None], SQUARE)[0]
    counts = np.array([16, 64, 256, 1024])
    errors = [abs(disk_factor(point, normal, SQUARE, count) - exact) for count in counts]
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(-1, abs=0.1)
    # Jittered places add noise of samples^-1, not of samples^-1/2.
    noise = [np.std([disk_factor(point, normal, SQUARE, count, jitter=seed) for seed in range(40)]) for count in counts]
    assert np.polyfit(np.log(counts), np.log(noise), 1)[0] == pytest.approx(-1, abs=0.2)


def test_samples_must_fill_a_grid():
    for samples in (0, 2, 15):
        with pytest.raises(SettingsError, match="square"):
            disk_factor([0, 0, 1], [0, 0, -1], SQUARE, samples)
    environment = core.Environment.from_polygons(FLOOR_AND_WALL)
    with pytest.raises(SettingsError, match="Unknown sampling"):
        core.form_factors(environment, method="disk", sampling="wild")


@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_cells_fill_their_patches(parts):
    environment = core.Environment.from_polygons([SQUARE * 2, SQUARE[:3], ARROW])
    fine = Cells.of(environment).divided(parts)
    np.testing.assert_allclose(np.bincount(fine.patches, fine.areas()), environment.areas)
    for patch in range(3):
        own = fine[fine.patches == patch]
        np.testing.assert_allclose(
            np.average(own.centers(), axis=0, weights=own.areas()), environment.centroids[patch], atol=1e-15
        )
        assert np.all(np.cross(own.u, own.v) @ environment.normals[patch] > 0)
    assert len(np.unique(fine.centers().round(9), axis=0)) == len(fine)


@pytest.mark.parametrize("sampling", ["adaptive", "uniform", "jittered"])
def test_patches_by_area_average(sampling):
    environment = core.Environment.from_polygons(FLOOR_AND_WALL)
    rows = disk_rows(environment, "none", 1e-2, sampling=sampling, samples=256)
    exact = contour_integral(*FLOOR_AND_WALL)
    assert np.abs(rows.matrix[[0, 1], [1, 0]] - exact).max() <= rows.errors.max()
    assert np.all(np.diag(rows.matrix) == 0)
    if sampling == "adaptive":
        np.testing.assert_allclose(rows.matrix[[0, 1], [1, 0]], exact, atol=1e-2)


@pytest.mark.parametrize("visibility", ["embree", "brute_force"])
def test_occluder_between_plates(visibility):
    case = CASES["obs-v3d-square"]
    matrix, _, result = surface_matrix(case, method="disk", visibility=visibility, accuracy=5e-3)
    names = [surface["name"] for surface in case["surfaces"]]
    assert result.rays > 0
    for expected in case["expected"]:
        value = matrix[names.index(expected["from"]), names.index(expected["to"])]
        assert abs(value - expected["F"]) <= allowed(case, "coarse", expected["F"])


def test_same_bits_for_any_threads_and_none_without_area():
    polygons, _ = polygons_of(CASES["obs-centre-mid"])
    line = np.array([[0, 0, 0.3], [1, 0, 0.3], [2, 0, 0.3]], float)
    with pytest.warns(UserWarning, match="without area"):
        environment = core.Environment.from_polygons([*polygons, line])
    first, second = (core.form_factors(environment, method="disk", accuracy=2e-2, threads=t).matrix for t in (1, 2))
    np.testing.assert_array_equal(first, second)
    assert not first[-1].any() and not first[:, -1].any()
    assert first.min() >= 0 and first.max() <= 1


def test_two_sided_patch_counts_both_sides():
    polygons = [SQUARE + np.array([0, 0, 1.0]), SQUARE, (SQUARE + np.array([0, 0, 3.0]))[::-1]]
    rows = disk_rows(core.Environment.from_polygons(polygons, two_sided=[True, False, False]), "none", 1e-2)
    down, up = contour_integral(polygons[0][::-1], polygons[1]), contour_integral(polygons[0], polygons[2])
    np.testing.assert_allclose(rows.matrix[0], [0, down / 2, up / 2], atol=5e-3)
