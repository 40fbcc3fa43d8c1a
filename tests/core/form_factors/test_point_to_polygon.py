"""The closed form of a point and a polygon, against published values, quadrature, and what must hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity import core
from radiosity.core.form_factors.point_to_polygon import FAR_DISTANCE, point_to_polygon

from tests.reference_cases import allowed, form_factor_cases, ids, polygons_of

CASES = form_factor_cases()
ELEMENTS = [
    name
    for name in ids(CASES, "element")
    if all("polygons" in surface for surface in CASES[name]["surfaces"]) and len(CASES[name]["surfaces"]) == 1
]
SQUARE = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float) - [0.5, 0.5, 0]  # front down
ARROW = np.array([[2, 1, 0], [1, 0, 0], [2, -1, 0], [0, 0, 0]], dtype=float)  # concave, front down
DOWN = np.array([0, 0, -1.0])


def factor(point, normal, polygon, **choices):
    return float(point_to_polygon(np.array([point], float), np.array([normal], float), polygon, **choices)[0])


def box(low, high):
    """Six faces of a box that look inward."""
    (x, y, z), (u, v, w) = low, high
    return [
        np.array(face, float)
        for face in (
            [[x, y, z], [u, y, z], [u, v, z], [x, v, z]],
            [[x, v, w], [u, v, w], [u, y, w], [x, y, w]],
            [[x, y, z], [x, v, z], [x, v, w], [x, y, w]],
            [[u, y, w], [u, v, w], [u, v, z], [u, y, z]],
            [[x, y, z], [x, y, w], [u, y, w], [u, y, z]],
            [[u, v, z], [u, v, w], [x, v, w], [x, v, z]],
        )
    ]


def unit_vectors(generator, count):
    vectors = generator.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def by_quadrature(points, normals, polygon, steps=400):
    """The same factors by summing a fine grid of small areas over the triangles: slow, plain, and clipped by sign."""
    environment = core.Environment.from_polygons([polygon])
    nodes = (np.arange(steps) + 0.5) / steps
    first, second = (a.ravel() for a in np.meshgrid(nodes, nodes))
    total = np.zeros(len(points))
    for a, b, c in environment.vertices[environment.triangles]:
        samples = a + first[:, None] * ((b - a) + second[:, None] * (c - b))
        weights = np.linalg.norm(np.cross(b - a, c - a)) * first / steps**2
        for row, (point, normal) in enumerate(zip(points, normals, strict=True)):
            rays = samples - point
            squares = np.einsum("si,si->s", rays, rays)
            cosines = np.maximum(rays @ normal, 0) * np.maximum(-rays @ environment.normals[0], 0)
            total[row] += (weights * cosines / (np.pi * squares**2)).sum()
    return total


@pytest.mark.parametrize("name", ELEMENTS)
def test_published_values_to_rounding(name):
    case = CASES[name]
    polygons, _ = polygons_of(case)
    elements = {element["name"]: element for element in case["elements"]}
    for expected in case["expected"]:
        element = elements[expected["from"]]
        value = sum(factor(element["point"], element["normal"], polygon) for polygon in polygons)
        assert abs(value - expected["F"]) <= allowed(case, "exact", expected["F"])


def test_every_point_of_a_room_sees_exactly_its_walls():
    generator = np.random.default_rng(1)
    # Points come as close as 1e-9 to walls and corners, and look anywhere: all faces get clipped at some horizon.
    places = generator.random((2000, 3))
    places[::2] = np.where(places[::2] < 0.5, 1e-9 * (0.1 + places[::2]), 1 - 1e-9 * places[::2])
    normals = unit_vectors(generator, 2000)
    normals[::5] = np.eye(3)[generator.integers(0, 3, 400)]
    low, high = np.array([-1.0, 2, 5]), np.array([3.0, 3, 5.5])
    points = low + places * (high - low)
    total = sum(point_to_polygon(points, normals, face) for face in box(low, high))
    np.testing.assert_allclose(total, 1, atol=1e-8)
    np.testing.assert_allclose(np.delete(total, np.s_[::2]), 1, atol=1e-13)


@pytest.mark.parametrize("polygon", [SQUARE, ARROW], ids=["convex", "concave"])
def test_any_point_and_direction_agrees_with_plain_quadrature(polygon):
    generator = np.random.default_rng(2)
    points = np.column_stack([generator.uniform(-1, 2.5, (30, 2)), -generator.uniform(0.3, 2, 30)])
    normals = unit_vectors(generator, 30)
    values = point_to_polygon(points, normals, polygon)
    assert (values > 0).sum() > 10
    # The grid's own error where the horizon cuts it: one row of 400.
    np.testing.assert_allclose(values, by_quadrature(points, normals, polygon), atol=2e-4, rtol=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31))
def test_parts_add_up_to_the_whole_even_across_the_horizon(seed):
    generator = np.random.default_rng(seed)
    points = generator.uniform(-2, 3, (50, 3)) * [1, 1, 1e-3 if seed % 2 else 1]
    normals = unit_vectors(generator, 50)
    environment = core.Environment.from_polygons([ARROW])
    parts = environment.vertices[environment.triangles]
    for two_sided in (False, True):
        whole = point_to_polygon(points, normals, ARROW, two_sided)
        np.testing.assert_allclose(
            sum(point_to_polygon(points, normals, p, two_sided) for p in parts), whole, atol=1e-12
        )
        assert whole.min() >= 0 and whole.max() <= 1


def test_nothing_arrives_behind_the_polygon_or_from_below_the_horizon():
    assert factor([0, 0, 1], [0, 0, -1], SQUARE) == 0
    assert factor([0, 0, -1], [0, 0, -1], SQUARE) == 0
    assert factor([0, 0, 1], [0, 0, -1], SQUARE, two_sided=True) == factor([0, 0, -1], [0, 0, 1], SQUARE) > 0.2


@pytest.mark.parametrize(
    "point",
    [[0, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [2, 0, 0], [0, 0, 1e-16]],
    ids=["in", "edge", "corner", "out", "eps"],
)
@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0]], ids=["up", "down", "aside"])
def test_a_point_in_the_plane_gets_nothing(point, normal):
    assert factor(point, normal, SQUARE, two_sided=True) == 0


def test_contact_fills_the_hemisphere():
    # A gap g uncovers about g^2 of the hemisphere at the center of a unit square.
    assert factor([0, 0, -1e-4], [0, 0, 1], SQUARE) == pytest.approx(1, abs=1e-7)
    assert factor([0, 0, -1e-9], [0, 0, 1], SQUARE) == pytest.approx(1, abs=1e-12)
    # On the edge, half of it; in the corner, a quarter.
    assert factor([0.5, 0, -1e-9], [0, 0, 1], SQUARE) == pytest.approx(0.5, abs=1e-8)
    assert factor([0.5, 0.5, -1e-9], [0, 0, 1], SQUARE) == pytest.approx(0.25, abs=1e-8)


@pytest.mark.parametrize("polygon", [SQUARE, ARROW], ids=["convex", "concave"])
def test_contour_and_quadrature_meet_at_their_border(polygon):
    area = core.Environment.from_polygons([polygon]).areas[0]
    size = np.linalg.norm(polygon - polygon[0], axis=1).max()
    for distance in (0.9 * FAR_DISTANCE * size, 1.1 * FAR_DISTANCE * size, 1e8):
        center = core.Environment.from_polygons([polygon]).centroids[0]
        value = factor(center + distance * DOWN, [0, 0, 1], polygon)
        # On the axis the factor of a distant area is area / (pi distance^2), to the square of size over distance.
        assert value == pytest.approx(area / (np.pi * distance**2), rel=1e-8)


@pytest.mark.parametrize("distance", [1e6, 1e8])
def test_far_factors_keep_their_digits_at_any_slant(distance):
    generator = np.random.default_rng(5)
    directions = unit_vectors(generator, 500) * [1, 1, -1]
    directions[:, 2] = -np.abs(directions[:, 2])
    normals = unit_vectors(generator, 500)
    values = point_to_polygon(distance * directions, normals, SQUARE)
    cosines = np.maximum(-np.einsum("ni,ni->n", directions, normals), 0)
    wanted = cosines * -directions[:, 2] / (np.pi * distance**2)
    # Where the receiver looks aside, the light's extent matters: one size over the distance.
    plain = cosines > 1e-2
    np.testing.assert_allclose(values[plain], wanted[plain], rtol=1e-10 if distance > 1e7 else 1e-8)


@pytest.mark.parametrize("scale, shift", [(1e-5, 0), (1e5, 0), (1, 1e5), (1e-5, 1)])
def test_scale_and_place_do_not_matter(scale, shift):
    generator = np.random.default_rng(3)
    points = generator.uniform(-2, 2, (200, 3)) - [0, 0, 2.5]
    normals = unit_vectors(generator, 200)
    here = point_to_polygon(points, normals, SQUARE)
    there = point_to_polygon(points * scale + shift, normals, SQUARE * scale + shift)
    # 1e5 sizes from the origin coordinates keep 11 digits.
    np.testing.assert_allclose(there, here, atol=1e-12 if shift == 0 else 1e-9)


def test_order_and_number_of_points_do_not_matter():
    generator = np.random.default_rng(4)
    points, normals = generator.uniform(-2, 2, (5000, 3)), unit_vectors(generator, 5000)
    together = point_to_polygon(points, normals, ARROW)
    order = generator.permutation(5000)
    np.testing.assert_allclose(point_to_polygon(points[order], normals[order], ARROW), together[order], atol=1e-15)
    np.testing.assert_allclose(point_to_polygon(points[7:8], normals[7:8], ARROW), together[7:8], atol=1e-15)
    np.testing.assert_allclose(point_to_polygon(points, normals, np.roll(ARROW, 2, axis=0)), together, atol=1e-13)
    assert point_to_polygon(points[:0], normals[:0], ARROW).shape == (0,)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="at least 3"):
        point_to_polygon(np.zeros((1, 3)), np.zeros((1, 3)), SQUARE[:2])
    with pytest.raises(ValueError, match=r"must both be \(n, 3\)"):
        point_to_polygon(np.zeros((1, 3)), np.zeros((2, 3)), SQUARE)


def test_polygon_without_area_gives_nothing():
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    assert factor([0, 0, -1], [0, 0, 1], line) == 0
