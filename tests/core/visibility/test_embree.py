"""Rays through embree against rays intersected by hand, and the pool that spreads them over threads."""

import builtins
import gc
import threading

import numpy as np
import pytest
from radiosity.core.errors import MissingRayEngineError
from radiosity.core.visibility import embree
from radiosity.core.visibility.embree import OFFSET, Frame, RayEngine, RayPool, Tracer, free_ways

from tests.scenes import box, cornell_box


def brute_force(vertices, triangles, origins, directions):
    """Distance (r,) and triangle (r,) of the first hit, by Moeller and Trumbore's test of every pair in float64."""
    corners = np.asarray(vertices, dtype=float)[triangles]
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
    first = distance.argmin(axis=1)
    nearest = distance[np.arange(len(origins)), first]
    return nearest, np.where(np.isfinite(nearest), first, -1)


def random_triangles(generator, count):
    middle = generator.uniform(-0.5, 0.5, (count, 1, 3))
    vertices = (middle + generator.normal(0, 0.1, (count, 3, 3))).reshape(-1, 3)
    return vertices, np.arange(3 * count).reshape(-1, 3)


def random_rays(generator, count):
    return generator.uniform(-0.5, 0.5, (count, 3)), generator.normal(size=(count, 3))


def test_first_hits_agree_with_brute_force():
    generator = np.random.default_rng(0)
    vertices, triangles = random_triangles(generator, 60)
    origins, directions = random_rays(generator, 3000)
    hits = Tracer.build(vertices.astype(np.float32), triangles).closest(
        origins.astype(np.float32), directions.astype(np.float32)
    )
    distance, triangle = brute_force(vertices, triangles, origins, directions)
    same = hits["primID"] == triangle
    # float32 may decide otherwise at an edge: one ray in a thousand at most.
    assert same.mean() > 0.999
    met = same & (triangle >= 0)
    assert met.sum() > 500
    np.testing.assert_allclose(hits["tfar"][met], distance[met], rtol=1e-3, atol=1e-5)
    corners = vertices[triangles[triangle[met]]]
    u, v = hits["u"][met, None].astype(float), hits["v"][met, None].astype(float)
    places = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
    np.testing.assert_allclose(places, origins[met] + distance[met, None] * directions[met], atol=1e-4)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", hits["Ng"][met], normals) > 0).all(), "normals follow the winding"


def test_visibility_agrees_with_brute_force_and_products_of_transmittance():
    generator = np.random.default_rng(1)
    vertices, triangles = random_triangles(generator, 40)
    transmittance = np.where(np.arange(40) % 4 == 0, 0.0, generator.uniform(0, 1, 40))
    transmittance[1] = 1.0
    origins, targets = generator.uniform(-0.5, 0.5, (2, 2000, 3))
    tracer = Tracer.build(vertices.astype(np.float32), triangles, transmittance)
    seen = tracer.visibility(origins.astype(np.float32), (targets - origins).astype(np.float32), 1.0)
    expected = np.ones(2000)
    for row in range(40):
        distance, _ = brute_force(vertices, triangles[row : row + 1], origins, targets - origins)
        expected *= np.where(distance < 1, transmittance[row], 1)
    assert (np.abs(seen - expected) < 1e-5).mean() > 0.998
    assert 0.02 < (expected == 0).mean() < 0.98
    opaque = Tracer.build(vertices.astype(np.float32), triangles)
    blocked = opaque.visibility(origins.astype(np.float32), (targets - origins).astype(np.float32), 1.0)
    distance, _ = brute_force(vertices, triangles, origins, targets - origins)
    assert ((blocked > 0) == (distance > 1)).mean() > 0.999


def test_ways_are_free_where_nothing_stands_on_them(monkeypatch):
    monkeypatch.setattr(embree, "CHUNK_RAYS", 300)
    generator = np.random.default_rng(3)
    vertices, triangles = random_triangles(generator, 40)
    starts, ends = generator.uniform(-0.5, 0.5, (2, 2000, 3))
    distance, _ = brute_force(vertices, triangles, starts, ends - starts)
    with RayPool(2) as pool:
        free = free_ways(Tracer.build(vertices.astype(np.float32), triangles), starts, ends - starts, pool)
    assert 0.02 < free.mean() < 0.98
    # Rays that pass an edge by less than the rounding of float32 may fall on its other side.
    assert (free == (distance > 1)).mean() > 0.999


def test_a_segment_that_ends_on_a_surface_is_not_blocked_by_it():
    vertices = np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], np.float32)
    tracer = Tracer.build(vertices, np.array([[0, 1, 2]]))
    up = np.array([[0, 0, 1.0], [0, 0, 1.001]], np.float32)
    np.testing.assert_array_equal(tracer.visibility(np.zeros((2, 3), np.float32), up), [1, 0])


@pytest.mark.parametrize("shares", [(0.3,), (0.5, 0.5), (0.9, 0.2, 0.7), (1.0, 0.5)])
def test_share_of_rays_that_pass_layers_is_the_product(shares):
    square = np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], np.float32)
    vertices = np.concatenate([square + np.array([0, 0, 0.1 * (row + 1)], np.float32) for row in range(len(shares))])
    tracer = Tracer.build(vertices, np.arange(len(vertices)).reshape(-1, 3), np.array(shares))
    count = 10_000
    luck = ((np.arange(count) + 0.5) / count).astype(np.float32)
    origins = np.zeros((count, 3), np.float32)
    directions = np.repeat(np.array([[0.0, 0.0, 1.0]], np.float32), count, axis=0)
    hits = tracer.closest(origins, directions, luck)
    # Evenly spread chances pass in exact proportion, layer by layer.
    reached = 1.0
    for row, share in enumerate(shares):
        stopped = hits["primID"] == row
        assert stopped.mean() == pytest.approx(reached * (1 - share), abs=1e-3)
        np.testing.assert_allclose(hits["tfar"][stopped], 0.1 * (row + 1), rtol=1e-3)
        reached *= share
    assert (hits["primID"] < 0).mean() == pytest.approx(reached, abs=1e-3)


def test_no_ray_leaves_a_closed_room():
    surfaces = cornell_box(12).surfaces
    generator = np.random.default_rng(2)
    vertices = (surfaces.vertices - 0.5).astype(np.float32)
    origins = np.repeat(np.array([[0.05, 0.4, 0.3]], np.float32), 200_000, axis=0)
    hits = Tracer.build(vertices, surfaces.triangles).closest(
        origins, generator.normal(size=(200_000, 3)).astype(np.float32)
    )
    assert (hits["primID"] >= 0).all()


def test_an_empty_scene_blocks_nothing():
    tracer = Tracer.build(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    rays = np.ones((4, 3), np.float32)
    np.testing.assert_array_equal(tracer.visibility(rays, rays), 1)
    np.testing.assert_array_equal(tracer.closest(rays, rays)["primID"], -1)


# --- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-30, 1e-5, 1.0, 1e5, 1e30])
def test_unit_frame_centers_and_scales_the_longest_side_to_one(scale):
    points = np.array([[1.0, 2.0, 3.0], [3.0, 3.0, 3.5], [2.0, 2.5, 3.1]]) * scale
    unit = Frame.around(points).to_unit(points)
    assert unit.dtype == np.float32
    np.testing.assert_allclose(np.ptp(unit, axis=0), [1, 0.5, 0.25], rtol=1e-6)
    np.testing.assert_allclose(unit.max(axis=0) + unit.min(axis=0), 0, atol=1e-7)


def test_unit_frame_of_nothing_and_of_one_point_has_size_one():
    assert Frame.around(np.empty((0, 3))).size == 1
    assert Frame.around(np.full((3, 3), 7.0)).size == 1


def test_engine_works_in_the_callers_units():
    vertices, faces, _ = box(divisions=1)
    triangles = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    shift = np.array([3e5, -2e5, 1e5])
    engine = RayEngine(1e3 * vertices + shift, triangles)
    origins = shift + 1e3 * np.array([[0.5, 0.5, 0.5], [0.25, 0.5, 0.5], [0.5, 0.5, 5.0]])
    directions = np.array([[0, 0, 2.0], [-1.0, 0, 0], [0, 0, 1.0]])
    triangle, _, _, distance = engine.closest(origins, directions)
    np.testing.assert_allclose(distance, [250, 250, np.inf], rtol=1e-5)
    assert triangle[2] == -1 and (triangle[:2] >= 0).all()
    # A target in the room is seen, one beyond the wall is not.
    targets = shift + 1e3 * np.array([[0.9, 0.9, 0.9], [-0.5, 0.5, 0.5], [0.5, 0.5, 6.0]])
    np.testing.assert_array_equal(engine.occluded(origins, targets), [False, True, False])
    assert engine.offset == pytest.approx(1e3 * OFFSET)


# --- threads ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 8])
@pytest.mark.parametrize(("count", "size"), [(0, 4), (1, 4), (4, 4), (103, 10), (10, 1)])
def test_pool_works_on_every_item_once_and_tells_its_progress(threads, count, size):
    done = np.zeros(count, int)

    def work(start, stop):
        assert 0 < stop - start <= size
        done[start:stop] += 1

    with RayPool(threads) as pool:
        shares = list(pool.chunks(work, count, size))
    np.testing.assert_array_equal(done, 1)
    assert shares == sorted(shares)
    assert not shares or shares[-1] == 1


@pytest.mark.parametrize("threads", [1, 4])
def test_pool_passes_errors_on_and_ends_its_threads(threads):
    before = set(threading.enumerate())

    def work(start, stop):
        if start >= 20:
            raise ValueError(f"chunk {start}")

    with pytest.raises(ValueError, match="chunk 20"), RayPool(threads) as pool:
        pool.run(work, 100, 10)
    assert set(threading.enumerate()) <= before


def test_closing_a_pools_work_waits_for_chunks_that_run():
    running, released = threading.Event(), threading.Event()
    ended = []

    def work(start, stop):
        if start == 1:
            running.set()
            released.wait(5)
            ended.append(start)

    with RayPool(2) as pool:
        steps = pool.chunks(work, 2, 1)
        next(steps)
        running.wait(5)
        threading.Timer(0.05, released.set).start()
        steps.close()
        assert ended == [1]


# --- without embreex --------------------------------------------------------------------------------------------------


def test_scenes_in_reference_cycles_are_collected_and_leave_the_device():
    """Within Blender, which shares its libembree4, the collector crashed when it took a scene's device first."""
    triangle = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]])
    for _ in range(200):
        tracer = Tracer.build(*triangle)
        tracer.me = tracer
    (device,) = gc.get_referents(tracer.scene)
    del tracer
    gc.collect()
    assert gc.get_referents(Tracer.build(*triangle).scene) == [device]


def test_missing_embreex_is_named_and_told(monkeypatch):
    whole = builtins.__import__

    def without_embreex(name, *rest, **more):
        if name.startswith("embreex"):
            raise ImportError(name)
        return whole(name, *rest, **more)

    assert embree.is_available()
    monkeypatch.setattr(builtins, "__import__", without_embreex)
    assert not embree.is_available()
    with pytest.raises(MissingRayEngineError, match="embreex package is missing"):
        Tracer.build(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]]))
