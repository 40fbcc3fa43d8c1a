"""Rows of form factors from points: what the methods of a matrix say about single receivers.

A final gather asks for the factors from a point, a differential area, to all patches. Each method has its own way,
registered beside its matrix (`matrix.METHODS`): it prepares what does not depend on the point once, and is then called
with blocks of points. This module holds what they share: the signature, the shifts that make each point's errors its
own, and the sum over patches, in blocks of bounded memory.

Limits: a point lies off the surfaces, by the ray engine's offset, or its own patch would stand before it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from ..visibility.embree import OFFSET
from .cached_hemispheres import turns_of_names

#: ``rows(points, normals, names)`` for (p, 3) places, (p, 3) unit normals and (p,) numbers: factors (p, n) to all
#: patches. The numbers turn what is random, so that a point's factors do not depend on which others are asked.
PointRows = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

#: Factors in hand at once, and points: a block is some tens of milliseconds, so that progress shows and Esc is heard.
BLOCK_FACTORS = 2**16
BLOCK_POINTS = 64


def shifts_of_names(names: np.ndarray, seed: int, dimensions: int) -> np.ndarray:
    """(p, dimensions) well-mixed numbers from 0 to 1 that belong to names (p,) and a seed."""
    turns = [turns_of_names(np.asarray(names), seed + 7919 * axis) for axis in range(dimensions)]
    return np.stack(turns, axis=1).astype(np.float64) / (2 * np.pi) % 1.0


@dataclass(frozen=True)
class PointExchange:
    """Light that patches of known radiosity send to points.

    Parameters
    ----------
    rows : PointRows
    radiosity : (n, 3) float
        Of the patches.
    """

    rows: PointRows
    radiosity: np.ndarray

    def irradiance(
        self, points: np.ndarray, normals: np.ndarray, names: np.ndarray
    ) -> Generator[float, None, np.ndarray]:
        """Irradiance (p, 3) float32 at points of surfaces in the unit frame; yields the share done."""
        lifted = (points + np.float32(OFFSET) * normals).astype(np.float64)
        normals = normals.astype(np.float64)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        out = np.empty((len(points), 3), np.float32)
        block = max(1, min(BLOCK_POINTS, BLOCK_FACTORS // max(len(self.radiosity), 1)))
        for start in range(0, len(points), block):
            part = slice(start, start + block)
            out[part] = self.rows(lifted[part], normals[part], names[part]) @ self.radiosity
            yield min(start + block, len(points)) / len(points)
        return out
