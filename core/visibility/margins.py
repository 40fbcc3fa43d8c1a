"""End margins: which part of a segment between two surfaces is tested for blockers.

Both ends lie on surfaces, and rounding puts them in front of or behind these. What is met within `end_margin` of an end
does not count. Every kind of visibility takes the same margin, so that all of them answer the same question.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from .embree import OFFSET


def end_margin(environment: Environment) -> float:
    """Length at either end of a segment in which nothing counts: the ray engine's offset, 1e-5 of the scene's size."""
    corners = environment.vertices[environment.triangles].reshape(-1, 3)
    return OFFSET * float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0


def trim(origins: np.ndarray, targets: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments without their ends.

    Parameters
    ----------
    origins, targets : (n, 3) float
    margin : float
        Length cut off at either end.

    Returns
    -------
    origins, targets : (n, 3) float64
    remaining : (n,) bool
        False where nothing remains: such a segment is visible, and its new ends mean nothing.
    """
    origins, targets = (np.asarray(points, dtype=np.float64).reshape(-1, 3) for points in (origins, targets))
    along = targets - origins
    lengths = np.linalg.norm(along, axis=1)
    remaining = lengths > 2 * margin
    step = along * (margin / np.where(remaining, lengths, 1))[:, None]
    return origins + step, targets - step, remaining
