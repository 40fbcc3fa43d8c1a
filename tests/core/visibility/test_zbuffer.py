"""The item buffer against polygons intersected by hand, and its rules at edges, near planes and borders."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.visibility import zbuffer
from radiosity.core.visibility.zbuffer import Loops, item_buffer

from tests.reference_cases import form_factor_cases, polygons_of

FORWARD = np.eye(3)[None]
SCENES = ("enc-cornell", "enc-L-room", "enc-facet-8", "enc-prism", "obs-shapiro", "ff-nonconvex-L", "obs-tri-tilted")


def centers(count):
    return (np.arange(count) * 2 + 1) / count - 1


def loops_of(polygons):
    return Loops.of(core.Environment.from_polygons(polygons))


def first_met(environment, origins, directions):
    """Patch (r,) and distance in lengths of the direction, by Moeller and Trumbore's test of every triangle."""
    corners = environment.vertices[environment.triangles]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(directions[:, None], other[None])
    determinant = np.einsum("rti,ti->rt", p, one)
    away = origins[:, None] - corners[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("rti,rti->rt", away, p) / determinant
        q = np.cross(away, one[None])
        v = np.einsum("rti,ri->rt", q, directions) / determinant
        distance = np.einsum("rti,ti->rt", q, other) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    distance = np.where(hit, distance, np.inf)
    nearest = distance.min(axis=1)
    return np.where(np.isfinite(nearest), environment.triangle_patches[distance.argmin(axis=1)], -1), nearest


@pytest.mark.parametrize("size", [(31, 32), (2, 57)])
@pytest.mark.parametrize("name", SCENES)
def test_each_sample_sees_what_a_ray_through_it_meets(name, size):
    polygons, _ = polygons_of(form_factor_cases()[name])
    environment = core.Environment.from_polygons(polygons)
    generator = np.random.default_rng(3)
    low, high = environment.vertices.min(axis=0), environment.vertices.max(axis=0)
    viewpoints = low + generator.random((12, 3)) * (high - low)
    views = np.linalg.qr(generator.normal(size=(12, 3, 3)))[0]
    columns, rows = centers(size[0]), centers(size[1])
    items, depths = item_buffer(viewpoints, views, Loops.of(environment), columns, rows)
    image = np.stack(np.broadcast_arrays(columns, rows[:, None], 1.0), axis=-1).reshape(-1, 3)
    directions = np.einsum("pi,vij->vpj", image, views).reshape(-1, 3)
    patches, distances = first_met(environment, np.repeat(viewpoints, len(image), axis=0), directions)
    # Random views have no sample on an edge.
    np.testing.assert_array_equal(items.ravel(), patches)
    np.testing.assert_allclose(depths.ravel(), distances, rtol=1.1 * zbuffer.BACK_FACE)
    assert (patches >= 0).mean() > 0.02


def test_two_buffers_hold_the_same_whatever_the_size_of_blocks(monkeypatch):
    polygons, _ = polygons_of(form_factor_cases()["enc-cornell"])
    loops = loops_of(polygons)
    generator = np.random.default_rng(0)
    viewpoints = 100 + 300 * generator.random((5, 3))
    views = np.linalg.qr(generator.normal(size=(5, 3, 3)))[0]
    whole = item_buffer(viewpoints, views, loops, centers(24), centers(24))
    monkeypatch.setattr(zbuffer, "BLOCK", 40)
    parts = item_buffer(viewpoints, views, loops, centers(24), centers(24))
    np.testing.assert_array_equal(parts, whole)


def test_samples_on_shared_edges_belong_to_exactly_one_polygon():
    # Four triangles about the view's center: with odd resolutions, samples lie on all eight edges and on the center.
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float)
    triangles = [np.array([[0, 0, 1], square[i], square[(i + 1) % 4]]) for i in range(4)]
    loops = loops_of(triangles)
    covered = np.zeros((9, 9), int)
    for row in range(4):
        alone, _ = item_buffer(np.zeros((1, 3)), FORWARD, loops.select(np.array([row])), centers(9), centers(9))
        covered += alone[0] == 0
    np.testing.assert_array_equal(covered, 1)


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-6])
def test_nothing_is_too_near_to_be_seen(gap):
    # A plate just in front of the eye, and a wall beside it that runs on behind it.
    plate = np.array([[-1, -1, gap], [-1, 1, gap], [1, 1, gap], [1, -1, gap]], float)
    items, depths = item_buffer(np.zeros((1, 3)), FORWARD, loops_of([plate]), centers(7), centers(7))
    assert (items == 0).all()
    np.testing.assert_allclose(depths, gap, rtol=1e-12)
    wall = np.array([[gap, -5, -5], [gap, 5, -5], [gap, 5, 5], [gap, -5, 5]], float)
    items, depths = item_buffer(np.zeros((1, 3)), FORWARD, loops_of([wall]), centers(8), centers(8))
    assert (items[0] == np.where(centers(8) > 0, np.where(gap / centers(8) < 5, 0, -1), -1)).all()
    seen = items[0] == 0
    np.testing.assert_allclose(
        depths[0][seen], np.broadcast_to(gap / centers(8), (8, 8))[seen], rtol=1.1 * zbuffer.BACK_FACE
    )


def test_of_coincident_faces_the_one_that_faces_the_eye_is_seen():
    plate = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float)
    for order in ([plate, plate[::-1]], [plate[::-1], plate]):
        facing = 1 if order[0] is plate else 0
        items, _ = item_buffer(np.zeros((1, 3)), FORWARD, loops_of(order), centers(5), centers(5))
        assert (items == facing).all()


def test_a_polygon_seen_edge_on_is_not_seen():
    plate = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 2], [-1, 0, 2]], float)
    items, depths = item_buffer(np.array([[0.2, 0, 0.1]]), FORWARD, loops_of([plate]), centers(5), centers(5))
    assert (items == -1).all() and np.isinf(depths).all()


def test_each_row_may_have_columns_of_its_own():
    polygons, _ = polygons_of(form_factor_cases()["enc-cornell"])
    loops = loops_of(polygons)
    viewpoint, rows = np.array([[200.0, 150, 100]]), centers(6)
    columns = centers(9) * np.linspace(0.3, 2, 6)[:, None]
    items, _ = item_buffer(viewpoint, FORWARD, loops, columns, rows)
    for row in range(6):
        alone, _ = item_buffer(viewpoint, FORWARD, loops, columns[row], rows)
        np.testing.assert_array_equal(items[0, row], alone[0, row])
