"""Exact factors of any two planar polygons, against published values, closed forms, and what must hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity import core
from radiosity.core.form_factors.contour_integral import SHARE, contour_integral, contour_rows, exchanges
from radiosity.core.form_factors.edge_integrals import edge_integrals
from radiosity.core.form_factors.faces import Faces
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.form_factors.quadrature import integrate_pair
from radiosity.core.form_factors.sampling import PatchSampler, kronecker_points
from radiosity.core.form_factors.separated_pairs import moment_rule

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
UNOBSTRUCTED = [
    name
    for name in ids(CASES, "polygon-polygon", "extreme", "enclosure", "obstructed")
    if "obstructed" not in CASES[name]["tags"] and all("polygons" in surface for surface in CASES[name]["surfaces"])
]
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
STAR = np.array([[0, 0, 0], [2, -1, 0], [1, 0.2, 0], [2, 1.5, 0], [0.6, 0.5, 0], [-1, 1, 0]], dtype=float)


def rotation(seed):
    turned, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turned * np.linalg.det(turned)


def hinged(angle):
    """A unit square that shares an edge with SQUARE and looks at it, opened by an angle."""
    return np.array([[0, 0, 0], [0, 1, 0], [np.cos(angle), 1, np.sin(angle)], [np.cos(angle), 0, np.sin(angle)]])


def facing(gap, size=1.0):
    return (SQUARE * size + [0, 0, gap])[::-1]


def opposed_squares(gap):
    """Factor between unit squares that face each other (Howell C-11), in extended precision."""
    side = 1 / np.longdouble(gap)
    root = np.sqrt(1 + side * side)
    terms = np.log(root * root / np.sqrt(1 + 2 * side * side))
    terms += 2 * side * (root * np.arctan(side / root) - np.arctan(side))
    return float(2 * terms / (np.longdouble(np.pi) * side * side))


def random_polygon(generator, spread=2.0):
    """A star-shaped polygon, concave as a rule, in any position and attitude."""
    corners = generator.integers(3, 8)
    angles = (np.arange(corners) + 0.8 * generator.random(corners)) * 2 * np.pi / corners
    flat = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) * generator.uniform(0.3, 1, (corners, 1))
    return flat @ rotation(generator.integers(2**31)).T + spread * generator.uniform(-1, 1, 3)


@pytest.mark.parametrize("name", UNOBSTRUCTED)
def test_published_values_to_rounding(name):
    case = CASES[name]
    matrix, _, result = surface_matrix(case, method="contour_integral", visibility="none")
    names = [surface["name"] for surface in case["surfaces"]]
    for expected in case.get("expected", ()):
        ends = expected["to"] if isinstance(expected["to"], list) else [expected["to"]]
        value = sum(matrix[names.index(expected["from"]), names.index(end)] for end in ends)
        assert abs(value - expected["F"]) <= allowed(case, "exact", expected["F"])
        if expected["F"] == 0:
            assert value == 0
    if case.get("matrix"):
        wanted = np.array(case["matrix"]["F"])
        found = in_order(case, matrix, case["matrix"]["order"])
        assert np.all(np.abs(found - wanted) <= allowed(case, "exact", wanted))
        assert np.all(found[wanted == 0] == 0)
    assert result.rays == 0


@pytest.mark.parametrize("name", [name for name in ids(CASES, "extreme") if len(CASES[name]["surfaces"]) == 2])
def test_published_pairs_by_themselves(name):
    case = CASES[name]
    polygons, _ = polygons_of(case)
    names = [surface["name"] for surface in case["surfaces"]]
    for expected in case.get("expected", ()):
        pair = [polygons[names.index(expected[end])] for end in ("from", "to")]
        for value in (contour_integral(*pair), core.form_factor(*pair, method="contour_integral")):
            assert abs(value - expected["F"]) <= allowed(case, "exact", expected["F"])


@pytest.mark.parametrize("turn", [None, 7], ids=["aligned", "turned"])
@pytest.mark.parametrize("gap", [1e-9, 1e-6, 1e-3])
def test_near_contact_leaves_only_the_rim(gap, turn):
    turned = np.eye(3) if turn is None else rotation(turn)
    value = contour_integral(SQUARE @ turned.T, facing(gap) @ turned.T)
    assert value == pytest.approx(opposed_squares(gap), abs=1e-14)


@pytest.mark.parametrize("turn", [None, 7], ids=["aligned", "turned"])
@pytest.mark.parametrize("distance", [1e3, 1e6, 1e8])
def test_far_pairs_keep_their_digits(distance, turn):
    turned = np.eye(3) if turn is None else rotation(turn)
    wanted = (1 - 2 / (3 * distance**2)) / (np.pi * distance**2)
    # Turned coordinates at that distance are themselves rounded to distance times eps.
    value = contour_integral(SQUARE @ turned.T, facing(distance) @ turned.T)
    assert value == pytest.approx(wanted, rel=1e-9 if turn is None or distance < 1e7 else 1e-7)


@pytest.mark.parametrize("degrees", [0.01, 0.1, 1, 30, 120, 179, 179.9])
def test_hinge_by_parts_and_from_both_sides(degrees):
    wall = hinged(np.deg2rad(degrees))
    whole = contour_integral(SQUARE, wall)
    environment = core.Environment.from_polygons([SQUARE, wall])
    if degrees >= 1:
        # An area quadrature of the point-to-polygon formula, which shares nothing with the contour.
        value, error = integrate_pair(environment, 0, 1, 1e-7)
        assert whole == pytest.approx(value, abs=1e-6)
        assert error < 1e-5
    half = [wall[[0, 1, 2]], wall[[0, 2, 3]]]
    assert sum(contour_integral(SQUARE, part) for part in half) == pytest.approx(whole, rel=1e-8, abs=1e-15)
    assert contour_integral(wall, SQUARE) == pytest.approx(whole, rel=1e-8)
    turned = rotation(3)
    assert contour_integral(SQUARE @ turned.T, wall @ turned.T) == pytest.approx(whole, rel=1e-8)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_random_pairs_agree_with_area_quadrature(seed):
    # Crossing planes, concave outlines and clipped parts included.
    generator = np.random.default_rng(seed)
    pair = [random_polygon(generator, 0.8), random_polygon(generator, 0.8)]
    environment = core.Environment.from_polygons(pair)
    # Even means of the closed form, each turned its own way: their scatter tells how far they are off. With 8 of them
    # ten standard errors are passed once in 40,000 times.
    square = (kronecker_points(2**13, 2) + generator.random((8, 1, 2))) % 1
    points = PatchSampler(environment)(np.array([0]), square.reshape(1, -1, 2))[0]
    normals = np.broadcast_to(environment.normals[0], points.shape)
    means = point_to_polygon(points, normals, pair[1]).reshape(8, -1).mean(axis=1)
    error = means.std(ddof=1) / np.sqrt(8)
    assert error < 5e-4
    # What lies between the points shows in none of the means: below 1e-9 in 3,000 pairs.
    assert contour_integral(*pair) == pytest.approx(means.mean(), abs=10 * error + 1e-7)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_invariances_reciprocity_and_additivity(seed):
    generator = np.random.default_rng(seed)
    first, second = random_polygon(generator, 1.0), random_polygon(generator, 1.0)
    environment = core.Environment.from_polygons([first, second])
    areas, value = environment.areas, contour_integral(first, second)
    scale = 10.0 ** generator.uniform(-5, 5)
    turned, shift = rotation(seed), generator.normal(size=3)
    moved = [scale * (polygon @ turned.T + shift) for polygon in (first, second)]
    assert contour_integral(*moved) == pytest.approx(value, abs=1e-11)
    rolled = [np.roll(polygon, generator.integers(1, 7), axis=0) for polygon in (first, second)]
    assert contour_integral(*rolled) == pytest.approx(value, abs=1e-11)
    assert areas[1] * contour_integral(second, first) == pytest.approx(areas[0] * value, abs=1e-11 * areas.max())
    parts = environment.vertices[environment.triangles[environment.triangle_patches == 1]]
    assert sum(contour_integral(first, part) for part in parts) == pytest.approx(value, abs=1e-11)


def test_concave_polygon_cut_into_several_parts():
    # The star pierces the floor: three of its tips reach above.
    star = STAR[:, [0, 2, 1]] - [0, 0, 0.7]
    environment = core.Environment.from_polygons([star])
    floor = np.array([[-3, -2, 0], [3, -2, 0], [3, 2, 0], [-3, 2, 0]], float)
    for polygon in (star, star[::-1]):
        value, _ = integrate_pair(core.Environment.from_polygons([polygon, floor]), 0, 1, 1e-7)
        assert contour_integral(polygon, floor) == pytest.approx(value, abs=1e-6)
    parts = environment.vertices[environment.triangles]
    total = sum(contour_integral(floor, part) for part in parts)
    assert contour_integral(floor, star) == pytest.approx(total, abs=1e-12)


def box(x, y, z):
    low, high = SQUARE[::-1] * [x, y, 0], SQUARE * [x, y, 0] + [0, 0, z]
    faces = [low[::-1], high[::-1]]
    for i in range(4):
        a, b = SQUARE[i] * [x, y, 0], SQUARE[(i + 1) % 4] * [x, y, 0]
        up = np.array([0, 0, z])
        faces.append(np.array([b, a, a + up, b + up]))
    return faces


@pytest.mark.parametrize("turn", [None, 5], ids=["aligned", "turned"])
@pytest.mark.parametrize("size", [(1, 1, 1), (7, 3, 2), (1, 1, 1e-3), (1e3, 1, 1)])
def test_boxes_close(size, turn):
    turned = np.eye(3) if turn is None else rotation(turn)
    environment = core.Environment.from_polygons([face @ turned.T for face in box(*size)])
    rows = contour_rows(environment)
    # The mean rule of pairs that are far for their size is good to a relative 1e-10.
    np.testing.assert_allclose(rows.matrix.sum(axis=1), 1, atol=1e-12 if max(size) < 10 else 1e-10)
    assert np.all(np.diag(rows.matrix) == 0)
    exchange = environment.areas[:, None] * rows.matrix
    np.testing.assert_array_equal(exchange > 0, exchange.T > 0)


def grid_room(cells, turn=2):
    steps, faces = np.arange(cells) / cells, []
    for face in box(1, 1, 1):
        a, along, across = face[0], face[1] - face[0], face[3] - face[0]
        for u in steps:
            for v in steps:
                corner = a + u * along + v * across
                faces.append(np.array([corner, corner + along / cells, corner + (along + across) / cells]))
                faces.append(np.array([corner, corner + (along + across) / cells, corner + across / cells]))
    return core.Environment.from_polygons([face @ rotation(turn).T for face in faces])


def test_subdivided_room_closes():
    rows = contour_rows(grid_room(4))
    np.testing.assert_allclose(rows.matrix.sum(axis=1), 1, atol=1e-10)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4, 1e-6])
def test_fast_tier_keeps_its_bound(accuracy):
    generator = np.random.default_rng(11)
    scattered = [random_polygon(generator, 4.0) for _ in range(120)]
    for environment in (grid_room(4), core.Environment.from_polygons(scattered)):
        exact = contour_rows(environment)
        fast = contour_rows(environment, accuracy=accuracy, fast=True)
        smaller = np.minimum(environment.areas[:, None], environment.areas)
        deviation = environment.areas[:, None] * np.abs(fast.matrix - exact.matrix) / smaller
        assert deviation.max() <= accuracy
        assert np.all(deviation.max(axis=1) <= fast.errors * (1 + 1e-9) + 1e-12)
        assert fast.errors.max() <= accuracy
        # It is no copy of the exact one.
        assert deviation.max() > 1e-4 * accuracy


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
def test_fast_tier_is_right_where_patches_touch(accuracy):
    environment = grid_room(4)
    exact, fast = contour_rows(environment), contour_rows(environment, accuracy=accuracy, fast=True)
    corners = np.array(environment.polygons)
    gaps = np.linalg.norm(corners[:, None, :, None] - corners[None, :, None], axis=-1).min(axis=(2, 3))
    touching = (gaps < 1e-12) & (exact.matrix > 0)
    assert touching.sum() > 300
    # Near pairs may err by this share of the accuracy, however small their own factor is.
    deviation = np.abs(fast.matrix - exact.matrix)[touching]
    assert deviation.max() <= SHARE * accuracy
    # What touching pairs come to between their centers of area, as fast kernels of others compute them all.
    apart = environment.centroids - environment.centroids[:, None]
    squares = np.square(apart).sum(axis=2) + np.eye(len(apart))
    here = np.einsum("ijk,ik->ij", apart, environment.normals)
    there = -np.einsum("ijk,jk->ij", apart, environment.normals)
    centers = here * there * environment.areas / (np.pi * squares**2)
    assert (np.abs(centers / np.where(touching, exact.matrix, 1) - 1)[touching]).max() > 0.1


@pytest.mark.parametrize("shape", [SQUARE, SQUARE[:3], STAR], ids=["square", "triangle", "star"])
def test_moment_rule_errs_by_the_cube_of_size_over_distance(shape):
    errors, pair = [], np.array([0, 1])
    for size in (0.2, 0.1, 0.05):
        generator, shares = np.random.default_rng(21), []
        for _ in range(40):
            # Two faces that look at each other, each tilted, turned and moved aside at random.
            first, second = (size * shape @ tilt(generator) + generator.uniform(-0.5, 0.5, 3) * (1, 1, 0) for _ in pair)
            faces = Faces(core.Environment.from_polygons([first, np.add(second[::-1], (0, 0, 2))]))
            exact, _ = exchanges(faces, pair[:1], pair[1:], 0.0)
            found, bound = moment_rule(faces, pair[:1], pair[1:])
            error = abs(found[0, 0] - exact[0])
            assert error <= bound[0, 0] * faces.areas.min()
            shares.append(error / exact[0])
        errors.append(np.median(shares))
    # It were the square, 4 for a halving, without the moments. A square has no third ones, and reaches 16.
    falls = np.divide(errors[:-1], errors[1:])
    assert np.all(falls > 15 if shape is SQUARE else falls > 7)


def tilt(generator):
    """A turn by any angle in the plane of x and y, then one of up to 0.6 out of it."""
    turn, slant = generator.uniform(0, 2 * np.pi), generator.uniform(-0.6, 0.6)
    in_plane = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return in_plane @ [[1, 0, 0], [0, np.cos(slant), np.sin(slant)], [0, -np.sin(slant), np.cos(slant)]]


def test_pairs_in_a_matrix_are_those_of_pairs_alone():
    generator = np.random.default_rng(12)
    polygons = [random_polygon(generator, 1.5) for _ in range(12)]
    matrix = contour_rows(core.Environment.from_polygons(polygons)).matrix
    for i in range(12):
        for j in range(12):
            if i != j:
                assert matrix[i, j] == pytest.approx(contour_integral(polygons[i], polygons[j]), abs=1e-12)


def test_two_sided_patches_count_both_sides():
    wall, floor, roof = facing(1.0)[::-1], SQUARE, facing(3.0)
    both = contour_rows(core.Environment.from_polygons([wall, floor, roof], two_sided=[True, False, False]))
    down, up = contour_integral(wall[::-1], floor), contour_integral(wall, roof)
    np.testing.assert_allclose(both.matrix[0], [0, down / 2, up / 2], atol=1e-12)
    np.testing.assert_allclose(both.matrix[1:, 0], [down, up], atol=1e-12)


def test_patches_without_area_exchange_nothing():
    line = np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1]], float)
    with pytest.warns(UserWarning, match="without area"):
        assert contour_integral(SQUARE, line) == 0
    with pytest.warns(UserWarning, match="without area"):
        environment = core.Environment.from_polygons([SQUARE, line, facing(1.0)])
    rows = contour_rows(environment)
    assert rows.matrix[0, 2] == pytest.approx(0.19982489569838738, abs=1e-12)
    assert not rows.matrix[1].any() and not rows.matrix[:, 1].any()


def random_edges():
    """Pairs that touch at an end (10), cross (10), run on in one line (10), are parallel (10), or just pass (20)."""
    generator = np.random.default_rng(13)
    starts, edges, other_starts, other_edges = generator.normal(size=(4, 60, 3))
    other_starts[:10] = starts[:10]
    other_starts[10:20] = starts[10:20] + 0.4 * edges[10:20] - 0.7 * other_edges[10:20]
    other_edges[20:40] = edges[20:40] * generator.uniform(-2, 2, (20, 1))
    other_starts[20:30] = starts[20:30] + edges[20:30]
    return starts, edges, other_starts, other_edges


def test_edge_integrals_are_means_over_both_edges():
    starts, edges, other_starts, other_edges = random_edges()
    values = edge_integrals(starts, edges, other_starts, other_edges)
    places = (np.arange(1000) + 0.5) / 1000
    for i in range(60):
        here, there = starts[i] + places[:, None] * edges[i], other_starts[i] + places[:, None] * other_edges[i]
        mean = np.log(np.linalg.norm(here[:, None] - there, axis=2)).mean()
        # Cells of 1e-6 in which the logarithm is off by about 1 along a line of contact; by 1e-6 elsewhere.
        assert values[i] == pytest.approx(edges[i] @ other_edges[i] * mean, abs=1e-2 if 20 <= i < 40 else 2e-5)


def test_edge_integrals_add_up_to_rounding():
    starts, edges, other_starts, other_edges = random_edges()
    values = edge_integrals(starts, edges, other_starts, other_edges)
    # A few roundings of terms near 10.
    np.testing.assert_allclose(edge_integrals(other_starts, other_edges, starts, edges), values, atol=3e-14)
    for share in (0.4, 0.37, 1e-6):
        parts = edge_integrals(starts, share * edges, other_starts, other_edges)
        parts += edge_integrals(starts + share * edges, (1 - share) * edges, other_starts, other_edges)
        np.testing.assert_allclose(parts, values, atol=3e-14)
    close = edge_integrals(starts, edges, other_starts, other_edges, 1e-4)
    np.testing.assert_allclose(close, values, atol=1e-3)


@pytest.mark.parametrize("visibility", ["embree", "brute_force"])
def test_visible_share_of_blocked_pairs(visibility):
    blocked = CASES["obs-v3d-square"]
    matrix, _, result = surface_matrix(blocked, method="contour_integral", visibility=visibility, accuracy=1e-3)
    names = [surface["name"] for surface in blocked["surfaces"]]
    for expected in blocked["expected"]:
        value = matrix[names.index(expected["from"]), names.index(expected["to"])]
        assert abs(value - expected["F"]) <= allowed(blocked, "fine", expected["F"])
    assert result.rays > 0


def test_convex_rooms_need_no_rays_whatever_the_visibility():
    environment = core.Environment.from_polygons([face @ rotation(1).T for face in box(3, 2, 1)])
    result = core.form_factors(environment, method="contour_integral", visibility="embree")
    assert result.rays == 0
    np.testing.assert_allclose(result.matrix.sum(axis=1), 1, atol=1e-12)
