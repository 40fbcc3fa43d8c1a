"""Receivers of meshes that modifiers reshape: moved onto the surface that is seen.

The artist's mesh holds the light, but a bevel or a subdivision surface cuts its corners off. A corner left standing
outside would see past the walls of its own room. It is moved along its normal onto the surface, and where the corner
itself is gone, it looks for the rest of its face further in.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .receivers import Receivers

#: Parts of the way to the middle of its face at which a receiver looks for the surface.
STEPS = (0.0, 0.05, 0.15, 0.4)

#: How far above and below it looks, in sizes of the faces around: modifiers move a surface by a part of a face.
REACH = 0.5

#: Cosine between the receiver's normal and that of a surface that may be its own.
ALIKE = 0.7


def snap_to_surface(tracer: Tracer, receivers: Receivers, chosen: np.ndarray, pool: RayPool) -> Receivers:
    """Receivers whose `chosen` (r,) ones lie on the nearest traced surface that faces as they do.

    Those that find none stay where they are.
    """
    points = receivers.points.copy()
    left = np.nonzero(chosen)[0]
    for step in STEPS:
        if not len(left):
            break
        places = receivers.points[left] + np.float32(step) * receivers.inward[left]
        normals = receivers.normals[left]
        reach = (np.float32(REACH) * receivers.sizes[left] + np.float32(4 * OFFSET))[:, None]
        found, heights = own_surface(tracer, places + reach * normals, -reach * normals, normals, pool)
        points[left[found]] = (places + (1 - heights[:, None]) * reach * normals)[found]
        left = left[~found]
    return replace(receivers, points=points)


def own_surface(tracer, starts, segments, normals, pool):
    """Whether a surface that faces as the normals (n, 3) crosses each segment or its double, and where, in lengths of
    it; of several the one nearest to its end is taken."""
    found, where = np.zeros(len(starts), bool), np.ones(len(starts), np.float32)

    def work(start: int, stop: int) -> None:
        travelled = np.zeros(stop - start, np.float32)
        going = np.arange(stop - start)
        while len(going):
            rows = start + going
            hits = tracer.closest(starts[rows] + travelled[going, None] * segments[rows], segments[rows])
            travelled[going] += hits["tfar"]
            met = (hits["primID"] >= 0) & (travelled[going] <= 2)
            facing = np.einsum("ij,ij->i", hits["Ng"], normals[rows])
            own = met & (facing > ALIKE * np.linalg.norm(hits["Ng"], axis=1))
            nearer = own & (~found[rows] | (np.abs(travelled[going] - 1) < np.abs(where[rows] - 1)))
            where[rows[nearer]] = travelled[going[nearer]]
            found[rows[nearer]] = True
            going = going[met]
            length = np.linalg.norm(segments[start + going], axis=1)
            travelled[going] += np.float32(OFFSET) / np.maximum(length, np.float32(1e-12))

    pool.run(work, len(starts), CHUNK_RAYS)
    return found, where
