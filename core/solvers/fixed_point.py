"""Bounces among patches summed as a fixed point, B = E + rho (D + F B), by Anderson's acceleration of Jacobi sweeps.

Each sweep is one product with the sparse factors, and the next starts from a mix of the last (`anderson`), for a few
vectors of memory. Cost: one product a sweep; five to fifteen sweeps in common rooms.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from .anderson import MEMORY, mixed
from .sparse_rows import SparseRows

#: Sweeps at most.
MAX_SWEEPS = 200


def fixed_point(
    factors: SparseRows,
    emitted: np.ndarray,
    given: np.ndarray,
    reflectance: np.ndarray,
    areas: np.ndarray,
    tolerance: float,
) -> Generator[float, None, tuple[np.ndarray, np.ndarray, int, float]]:
    """Radiosity and irradiance (2P, 3) of fronts and backs, the sweeps it took and the last one's relative change.

    Parameters
    ----------
    factors : SparseRows
        (2P, 2P).
    emitted, given, reflectance : (2P, 3) float32
        Exitance, and irradiance that no bounce changes.
    areas : (P,) float
    tolerance : float
        It stops when a sweep changes the radiosity by less than this, RMS by area, relative to the RMS of the
        radiosity.
    """
    radiosity = emitted
    steps: list[np.ndarray] = []
    changes: list[np.ndarray] = []
    for sweep in range(MAX_SWEEPS):
        yield sweep / MAX_SWEEPS
        irradiance = given + factors.times(radiosity)
        image = emitted + reflectance * irradiance
        change = image - radiosity
        residual = _size(change, areas) / max(_size(image, areas), 1e-30)
        if residual <= tolerance:
            radiosity = image
            break
        steps.append(image)
        changes.append(change)
        radiosity = mixed(steps[-MEMORY:], changes[-MEMORY:])
    return np.maximum(radiosity, 0), irradiance, sweep + 1, residual


def _size(values: np.ndarray, areas: np.ndarray) -> float:
    """RMS of (2P, 3) values, weighted by area."""
    squares = (values.astype(np.float64) ** 2).sum(axis=1)
    return float(np.sqrt((areas * (squares[: len(areas)] + squares[len(areas) :])).sum()))
