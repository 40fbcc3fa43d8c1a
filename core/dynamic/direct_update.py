"""Direct light brought up to date: only where something that changed can stand between a receiver and a light.

What a receiver gets from a light depends on what its own rays meet, and, since neighbors that disagree mark a penumbra,
on whether theirs still agree. So values can change where the hull of receiver and light meets an old or a new place,
and at the neighbors of such receivers; to know whether those are in a penumbra their own neighbors are asked again too.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from ..lights import Light
from ..lights.direct_light import direct_light
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .affected import hull_meets


def receivers_in_reach(
    lights: Sequence[Light], points: np.ndarray, normals: np.ndarray, boxes: np.ndarray, pool: RayPool
) -> np.ndarray:
    """(n,) bool: whether what happens in the boxes (k, 2, 3) can change the direct light at points (n, 3) with normals
    (n, 3). All in the unit frame."""
    reached = np.zeros(len(points), bool)

    def work(start: int, stop: int) -> None:
        begin = np.asarray(points[start:stop], dtype=float) + OFFSET * normals[start:stop]
        for light in lights:
            reached[start:stop] |= hull_meets(begin, *light.ends(begin), boxes)

    pool.run(work, len(points), CHUNK_RAYS)
    return reached


def updated_direct_light(
    tracer: Tracer,
    lights: Sequence[Light],
    points: np.ndarray,
    normals: np.ndarray,
    edges: np.ndarray,
    penumbra_rays: int,
    pool: RayPool,
    before: np.ndarray,
    fresh: np.ndarray,
    boxes: np.ndarray,
    seed: int = 0,
    colors: np.ndarray | None = None,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Irradiance (n, c) float32 that `core.lights.direct_light.direct_light` would give, and the rays it took.

    The lights must be those of `before`: what has moved does not shine. Up to `MAX_LIGHTS` lights the result is that of
    the full computation; beyond, other lights are drawn, and it is so in expectation only.

    Parameters
    ----------
    tracer : Tracer
        Of the scene as it is now; see `direct_light` for what is not named here.
    before : (n, c) float32
        Irradiance before the change.
    fresh : (n,) bool
        Receivers that are new or in another place, so that their row of `before` means nothing.
    boxes : (k, 2, 3) float
        Old and new places of what has changed, in the unit frame.
    """
    changed = fresh | receivers_in_reach(lights, points, normals, boxes, pool)
    wanted = _with_neighbors(changed, edges)
    asked = _with_neighbors(wanted, edges)
    rows = np.flatnonzero(asked)
    within = asked[edges].all(axis=1)
    numbers = np.cumsum(asked) - 1
    light, rays = yield from direct_light(
        tracer, lights, points[rows], normals[rows], numbers[edges[within]], penumbra_rays, pool, seed, colors=colors
    )
    out = before.copy()
    out[wanted] = light[wanted[rows]]
    return out, rays


def _with_neighbors(marked: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(n,) bool: those marked, and those that an edge (e, 2) joins to them."""
    wider = marked.copy()
    wider[edges[marked[edges].any(axis=1)].ravel()] = True
    return wider
