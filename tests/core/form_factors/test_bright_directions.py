"""Small bright things are looked at closely: a room lit through a window alone."""

import numpy as np
import pytest
from radiosity.core.discretization.patches import build_patches
from radiosity.core.form_factors.bright_directions import GRID, BrightDirections, sharpen
from radiosity.core.form_factors.cached_hemispheres import (
    HitTable,
    gather,
    hemisphere_directions,
    turns_of,
    variants_of,
)
from radiosity.core.form_factors.concentric import disk_to_square, square_to_disk
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.frames import turned_frames
from radiosity.core.progress import finish
from radiosity.core.visibility.embree import RayPool, Tracer

from tests.bakes import Thing, all_light, bake, corner_places, relative_rms, scene_of
from tests.scenes import grid, joined

SIZE = np.array([5.0, 4.0, 3.0])


def room_with_window(width, reflectance=0.0, cell=0.12):
    """A closed room whose far wall has a square window in its middle, and the window's corners, seen from inside."""
    x, y, z = SIZE
    low, high = (x - width) / 2, (x + width) / 2
    under, over = (z - width) / 2, (z + width) / 2
    quads = [
        ((0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0)),
        ((0, 0, z), (0, y, z), (x, y, z), (x, 0, z)),
        ((0, 0, 0), (0, y, 0), (0, y, z), (0, 0, z)),
        ((x, 0, 0), (x, 0, z), (x, y, z), (x, y, 0)),
        ((0, 0, 0), (0, 0, z), (x, 0, z), (x, 0, 0)),
        *(
            ((a, y, c), (b, y, c), (b, y, d), (a, y, d))
            for a, b, c, d in ((0, low, 0, z), (high, x, 0, z), (low, high, 0, under), (low, high, over, z))
        ),
    ]
    parts = []
    for quad in np.asarray(quads, dtype=float):
        sides = np.linalg.norm(quad[1] - quad[0]), np.linalg.norm(quad[3] - quad[0])
        parts.append(grid(quad, *(max(1, round(side / cell)) for side in sides)))
    vertices, faces, _ = joined(*parts)
    window = np.array([(low, y, under), (high, y, under), (high, y, over), (low, y, over)])
    return scene_of(Thing(vertices, faces, reflectance=reflectance, name="Room"), sky=1.0), window


def through(window, scene):
    """Irradiance (c,) at the corners from a sky of radiance 1 seen through the window and nothing else."""
    places = corner_places(scene)
    normals = np.asarray(scene.receivers[0].corner_normals, dtype=np.float64)
    return np.pi * point_to_polygon(places, normals, window)


@pytest.mark.parametrize(("width", "kept"), [(0.5, 0.06), (1.0, 0.03), (2.0, 0.03)])
def test_light_through_a_window_keeps_the_accuracy_asked_for(width, kept):
    # Nothing but the window sends light here, the hardest case there is. The smallest, a four hundredth of what the far
    # wall sees, is known to too few neighbors of some corners: twice the accuracy asked for.
    scene, window = room_with_window(width, cell=0.2)
    exact = through(window, scene)
    result = bake(scene, accuracy=0.03, threads=0)
    light = all_light(result)[:, 0]
    error = relative_rms(light, exact)
    assert error < kept
    # What few have seen must not be missed on the mean.
    assert light.mean() == pytest.approx(exact.mean(), rel=0.01)
    assert 0.6 * error < result.statistics["estimated_error"] < 2 * error


def test_an_even_room_stays_even():
    # Where all directions are equally bright, what is looked at closely and what is not must add up to the whole.
    vertices, faces = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 6, 6)
    marked = np.zeros((3, GRID * GRID), bool)
    marked[0, :40] = marked[1, 100:103] = True
    marked[2, 0] = True
    scene = scene_of(Thing(vertices, faces), sky=1.0)
    corners = scene.surfaces.vertices
    tracer = Tracer.build(corners.astype(np.float32), scene.surfaces.triangles, np.zeros(len(scene.surfaces.triangles)))
    patches = build_patches(corners, scene.surfaces.triangles, np.zeros(len(scene.surfaces.triangles), int), 100)
    table = HitTable(patches, np.zeros(len(scene.surfaces.triangles), bool), scene.sky)
    points = np.array([[0.3, 0.3, 0], [0.5, 0.5, 0], [0.7, 0.2, 0]], np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (3, 1))
    names = np.arange(3)
    with RayPool(1) as pool:
        seen = finish(gather(tracer, table, points, normals, 128, pool, names=names))
        radiosity = table.table(np.zeros((2 * patches.count, 3)))
        args = (lambda rows: radiosity[rows, :3], points, normals, seen.rows, marked, np.full(3, 1e-4), np.pi, names, 0)
        values, rays = finish(sharpen(tracer, table, *args, pool))
    np.testing.assert_allclose(values, np.pi, rtol=1e-6)
    assert rays == 4 * 4 * marked.sum()  # divided once at the start, for the brightness met, and no further


def test_the_square_and_the_disk_are_each_others_image():
    points = np.random.default_rng(0).random((2000, 2))
    disk = square_to_disk(points)
    assert (np.linalg.norm(disk, axis=1) <= 1 + 1e-12).all()
    np.testing.assert_allclose(disk_to_square(disk), points, atol=1e-12)
    # Equal areas: as many points in the inner half of the disk as in the outer.
    ticks = (np.arange(200) + 0.5) / 200
    even = square_to_disk(np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2))
    assert (np.linalg.norm(even, axis=1) < np.sqrt(0.5)).mean() == pytest.approx(0.5, abs=0.005)


def test_neighbors_tell_each_other_where_it_is_bright_and_nobody_himself():
    rays, seed = 64, 3
    normals = np.array([[0, 0, 1.0], [0, 0, 1.0], [0.6, 0, 0.8]], np.float32)
    names = np.arange(3)
    bright = np.zeros((3, rays), bool)
    bright[1, 5] = True
    known = BrightDirections(3)
    points = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0]], np.float32)  # too far apart for others that stand near
    known.note(names, points, normals, bright, names, seed)
    marked = known.around(names, points, normals, np.array([[1, 2], [1, 0], [1, 0]]))
    assert marked[0].any() and not marked[1].any() and marked[2].any()
    assert marked.sum(axis=1).max() <= 9
    lattice = hemisphere_directions(rays)[variants_of(names)]
    world = np.matmul(lattice, turned_frames(normals, turns_of(3, seed)))[1, 5]
    for receiver in (0, 2):
        one, other, _ = turned_frames(normals, np.zeros(3, np.float32))[receiver]
        cell = (disk_to_square(np.array([[world @ one, world @ other]])) * GRID).astype(int)[0]
        assert marked[receiver, cell[0] * GRID + cell[1]]
