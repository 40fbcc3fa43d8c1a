"""The traced mesh divided into patches that each have one light.

A cell that a wall crosses, or that something stands near to, is split until each part belongs to one side. So is a cell
on which the lights shine unevenly, if that outweighs the light of a whole cell: behind a shining pane, say, a wall gets
a hundred times what the room gets, and a patch half behind it would bring that light into the room.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .discretization.patches import POINTS, Patches, build_patches, lone_cells, probe_segments, split_cells
from .form_factors.cached_hemispheres import HitTable, gather
from .lights import Light
from .lights.direct_light import direct_light
from .progress import finish
from .visibility.embree import RayPool, Tracer, free_ways

#: Cells to which something stands nearer than this many of their sides are split: light changes over that distance.
NEAR = 1.0

#: Rays per sample point that measure how near.
PROBE_RAYS = 8

#: Cells are split on which the flux of the lights varies, as a standard deviation, by more than this many times what a
#: cell gets on the mean. A garage with a shining window kept a bias of 1.1 % of its light, and of 7.0 % without; with
#: twice as many splits allowed it were 0.6, 1.2 and 1.8 % at 1, 3 and 10 times.
UNEVEN = 2.0

#: Rounds of splitting by light, each of which may take the half of what the other splits may.
LIGHT_ROUNDS = 2

#: Rays per light and sample point where a light may be seen in part: all that is asked is whether the points differ.
LIGHT_RAYS = 8


def divided_patches(
    tracer: Tracer,
    lights: Sequence[Light],
    vertices: np.ndarray,
    triangles: np.ndarray,
    looks: np.ndarray,
    target: int,
    pool: RayPool,
    seed: int,
) -> tuple[Patches, np.ndarray]:
    """Patches of traced triangles, and which of them (P,) bool a wall still crosses.

    Parameters
    ----------
    tracer : Tracer
        Of these triangles.
    lights : sequence of Light
        In the unit frame.
    vertices, triangles, looks, target
        As of `build_patches`.
    """
    patches = build_patches(vertices, triangles, looks, target)
    cells, starts, segments = probe_segments(patches, vertices, triangles)
    crossed = _crossed(tracer, starts, segments, pool)
    nearness = _nearness(tracer, patches, cells, pool)
    urgent = np.lexsort((nearness, ~crossed))
    urgent = urgent[crossed[urgent] | (nearness[urgent] < NEAR)]
    whole = patches.count
    patches = split_cells(patches, vertices, triangles, cells[urgent], target)
    # Parts that a wall still crosses are split once more: they alone would carry light to its other side.
    cells, starts, segments = probe_segments(patches, vertices, triangles, whole)
    crossed = _crossed(tracer, starts, segments, pool)
    patches = split_cells(patches, vertices, triangles, cells[crossed], target)
    patches = _split_by_light(patches, tracer, lights, vertices, triangles, target, pool, seed)
    cells, starts, segments = probe_segments(patches, vertices, triangles)
    walled = np.zeros(patches.count, bool)
    walled[cells[_crossed(tracer, starts, segments, pool)]] = True
    # Only next to small patches is it sure that what lies aside is on the same side.
    walled &= np.sqrt(patches.areas) < 0.5 * patches.spacing
    return patches, walled


def _split_by_light(
    patches: Patches,
    tracer: Tracer,
    lights: Sequence[Light],
    vertices: np.ndarray,
    triangles: np.ndarray,
    target: int,
    pool: RayPool,
    seed: int,
) -> Patches:
    """Patches with the cells split, once more if need be, on which the lights shine most unevenly."""
    start, mean = 0, None
    for _ in range(LIGHT_ROUNDS):
        cells = lone_cells(patches, start)
        if not (len(lights) and len(cells)):
            break
        light, uneven = _light_on(tracer, lights, patches, cells, pool, seed)
        if mean is None:  # of all cells, not of those that had to be split
            mean = light.mean()
        urgent = np.argsort(-uneven, kind="stable")
        urgent = urgent[uneven[urgent] > UNEVEN * mean]
        start = patches.count
        patches = split_cells(patches, vertices, triangles, cells[urgent], target // 2)
    return patches


def _light_on(tracer, lights, patches: Patches, cells: np.ndarray, pool, seed) -> tuple[np.ndarray, np.ndarray]:
    """Flux (n,) of the lights on both sides of each cell, and its standard deviation among the sample points."""
    light, uneven = np.zeros(len(cells)), np.zeros(len(cells))
    points = np.ascontiguousarray(patches.points[cells].reshape(-1, 3))
    normals = np.ascontiguousarray(patches.normals[cells].reshape(-1, 3))
    middles = POINTS * np.arange(len(cells))[:, None]
    edges = np.stack(np.broadcast_arrays(middles, middles + np.arange(1, POINTS)), axis=2).reshape(-1, 2)
    for side in (normals, -normals):
        arriving, _ = finish(direct_light(tracer, lights, points, side, edges, LIGHT_RAYS, pool, seed))
        arriving = arriving.mean(axis=1, dtype=np.float64).reshape(-1, POINTS)
        light += patches.areas[cells] * arriving.mean(axis=1)
        uneven += patches.areas[cells] * arriving.std(axis=1)
    return light, uneven


def _crossed(tracer: Tracer, starts: np.ndarray, segments: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) bool: whether anything crosses one of the segments (n, s, 3) of each row."""
    free = free_ways(tracer, starts.reshape(-1, 3), segments.reshape(-1, 3), pool)
    return ~free.reshape(segments.shape[:2]).all(axis=1)


def _nearness(tracer: Tracer, patches: Patches, cells: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) harmonic mean distance to what stands around each cell, in sides of the cell."""
    points, normals = patches.points[cells].reshape(-1, 3), patches.normals[cells].reshape(-1, 3)
    nowhere = HitTable(patches, np.zeros(len(patches.first), bool), None)
    seen = finish(gather(tracer, nowhere, points, normals, PROBE_RAYS, pool))
    distances = 1 / (1 / seen.distances).reshape(-1, POINTS).mean(axis=1)
    return distances / np.sqrt(patches.areas[cells])
