"""The vertex formula: as published, its order of convergence, and matrices with shadows by silhouettes."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.point_to_point import point_to_point_rows, point_to_vertices
from radiosity.core.form_factors.vertex_grid import cell_middles, grid_steps, vertex_grid
from radiosity.core.visibility.silhouettes import SilhouetteVisibility

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
RULES = [name for name in ids(CASES, "rule") if name.startswith("rule-vertex")]
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
UP = np.array([0.0, 0, 1])
ABOVE = SQUARE[::-1] + UP


@pytest.mark.parametrize("name", RULES)
def test_published_formula_to_rounding(name):
    setup = CASES[name]["setup"]
    origin, u, v, normal = (np.array(setup["patch"][key], float) for key in ("origin", "u", "v", "normal"))
    patch = np.array([origin, origin + u, origin + u + v, origin + v])
    patch = patch if np.cross(u, v) @ normal > 0 else patch[::-1]
    for value in CASES[name]["values"]:
        result = point_to_vertices([setup["point"]], [setup["normal"]], patch, value["cells_per_side"])
        assert result[0] == pytest.approx(value["F"], rel=1e-9)


def test_weights_are_a_quarter_a_half_and_one():
    _, areas = vertex_grid(SQUARE[None], grid_steps(3))
    np.testing.assert_allclose(areas[0] * 9, np.outer([0.5, 1, 1, 0.5], [0.5, 1, 1, 0.5]))


@pytest.mark.parametrize("graded", [False, True])
@pytest.mark.parametrize(
    "corners",
    [SQUARE, SQUARE[[0, 1, 2, 2]], [[0, 0, 0], [2, 0, 0], [1.5, 1, 0], [0, 0.5, 0]]],
    ids=["square", "triangle", "trapezoid"],
)
def test_grids_keep_the_area(corners, graded):
    corners = np.array(corners, dtype=float)
    area = core.Environment.from_polygons([corners]).areas[0]
    for make in (vertex_grid, cell_middles):
        points, areas = make(corners[None], grid_steps(5, graded))
        assert areas.sum() == pytest.approx(area, rel=1e-14)
        # Nothing outside, and the center of area to the square of the spacing.
        assert (points >= 0).all()
        center = (points * areas[..., None]).sum(axis=(0, 1, 2)) / areas.sum()
        np.testing.assert_allclose(center, core.Environment.from_polygons([corners]).centroids[0], atol=0.35 / 10)


def test_error_falls_with_the_square_of_the_spacing():
    exact = core.configuration_factor([0.3, 0.6, 0], [0, 0, 1], ABOVE)
    cells = np.array([4, 8, 16, 32, 64])
    errors = [abs(point_to_vertices([[0.3, 0.6, 0]], [[0, 0, 1]], ABOVE, int(n))[0] - exact) for n in cells]
    slope = np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2, abs=0.05)


def test_a_shadow_takes_its_vertices_away():
    # The plate shades x, y from -1/2 to 1/2 as seen from the origin: 3 x 3 vertices of an 8 x 8 grid lie inside.
    plate = np.array([[-0.25, -0.25, 0.5], [0.25, -0.25, 0.5], [0.25, 0.25, 0.5], [-0.25, 0.25, 0.5]])
    light = np.array([[-1, -1, 1], [-1, 1, 1], [1, 1, 1], [1, -1, 1]], dtype=float)
    floor = light[::-1] * [1, 1, 0]
    visibility = SilhouetteVisibility(core.Environment.from_polygons([floor, light, plate]))
    point, normal = np.array([[0.0, 0, 0]]), np.array([[0, 0, 1.0]])
    vertices, areas = vertex_grid(light[None], grid_steps(8))
    squares = (vertices**2).sum(axis=-1)
    lit = (np.abs(vertices[..., :2]) >= 0.5).any(axis=-1)
    wanted = (areas / (np.pi * squares**2))[lit].sum()
    assert point_to_vertices(point, normal, light, 8, visibility)[0] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("name", ["enc-cube", "obs-two-overlap", "obs-tri-tilted"])
def test_matrix_at_the_coarse_level(name):
    case = CASES[name]
    matrix, _, result = surface_matrix(case, method="point_to_point", accuracy=2e-3)
    assert np.isfinite(matrix).all() and matrix.min() >= 0 and matrix.max() <= 1
    names = [surface["name"] for surface in case["surfaces"]]
    if "matrix" in case:
        expected = np.array(case["matrix"]["F"])
        matrix = in_order(case, matrix, case["matrix"]["order"])
        assert result.closed
    else:
        pairs = [(names.index(e["from"]), names.index(e["to"])) for e in case["expected"]]
        expected = np.array([e["F"] for e in case["expected"]])
        matrix = np.array([matrix[pair] for pair in pairs])
    assert (np.abs(matrix - expected) <= allowed(case, "coarse", expected)).all()


@pytest.mark.parametrize("name", ["enc-facet-8", "enc-box345-1cube"])
def test_where_walls_touch_in_shadow_the_stated_error_holds(name):
    case = CASES[name]
    matrix, _, result = surface_matrix(case, method="point_to_point", accuracy=1e-2)
    error = np.abs(in_order(case, matrix, case["matrix"]["order"]) - np.array(case["matrix"]["F"])).max()
    assert error <= result.estimated_error <= 2e-2, (error, result.estimated_error)


def test_silhouettes_and_tree_give_the_same_factors():
    polygons, _ = polygons_of(CASES["enc-box345-1cube"])
    # Off its place, so that no vertex lies on the very edge of a shadow, where either answer is right.
    polygons[6:] = [face + np.array([0.0137, 0.0071, 0.0219]) for face in polygons[6:]]
    environment = core.Environment.from_polygons(polygons)
    by_silhouettes, by_tree, free = (
        point_to_point_rows(environment, name, 1e-2, cells=4).matrix for name in ("silhouettes", "bsp", "none")
    )
    assert np.abs(by_silhouettes - free).max() > 0.01
    np.testing.assert_allclose(by_silhouettes, by_tree, atol=1e-14)


def test_a_two_sided_patch_gives_half_to_either_side():
    both = core.Environment.from_polygons([SQUARE, ABOVE], two_sided=[True, False])
    one = core.Environment.from_polygons([SQUARE, ABOVE])
    half, whole = (point_to_point_rows(e, "none", 1e-3, cells=4).matrix for e in (both, one))
    assert half[0, 1] == pytest.approx(whole[0, 1] / 2, rel=1e-12)
    assert half[1, 0] == pytest.approx(whole[1, 0], rel=1e-12)


def test_wrong_grids_are_refused():
    environment = core.Environment.from_polygons([SQUARE, ABOVE])
    for cells in (0, -1, 1.5):
        with pytest.raises(SettingsError, match="whole number"):
            core.form_factors(environment, method="point_to_point", cells=cells)
    with pytest.raises(SettingsError, match="3 or 4 corners"):
        point_to_vertices([[0, 0, 0]], [[0, 0, 1]], np.zeros((5, 3)), 2)
