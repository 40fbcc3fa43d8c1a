"""Where a path goes on from what it has met: just before it, so that its next ray does not start in the surface."""

from __future__ import annotations

import numpy as np

from .embree import OFFSET

#: How far before what it meets a path goes on, at most half-way.
SHORT = 4 * OFFSET


def before_hits(origins: np.ndarray, directions: np.ndarray, hits: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places just before hits, in the unit frame.

    Parameters
    ----------
    origins, directions : (n, 3) float32
        Unit directions.
    hits : dict
        What `Tracer.closest` gave for them.

    Returns
    -------
    places : (n, 3) float32
        The origins themselves where nothing was met.
    normals : (n, 3) float32
        Of unit length, on the side that the ray came from.
    cosines : (n,) float32
        Between the direction and the surface's own normal: above 0 where it was met from behind.
    """
    normals = hits["Ng"] / np.maximum(np.linalg.norm(hits["Ng"], axis=1, keepdims=True), np.float32(1e-30))
    cosines = np.einsum("ij,ij->i", normals, directions)
    normals[cosines > 0] *= -1
    # Short of the hit, and lifted only where that is not enough: lifted from the hit itself a path would leave the
    # room through the crack where its walls meet.
    short = np.minimum(np.float32(SHORT), np.float32(0.5) * hits["tfar"])
    lift = np.maximum(np.float32(OFFSET) - short * np.abs(cosines), 0)
    length = np.where(hits["primID"] >= 0, hits["tfar"] - short, np.float32(0))
    return origins + length[:, None] * directions + lift[:, None] * normals, normals, cosines
