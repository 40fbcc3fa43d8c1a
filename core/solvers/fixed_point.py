"""Bounces among patches summed as a fixed point, B = E + rho (D + F B), by Anderson's acceleration of Jacobi sweeps.

Each sweep is one product with the sparse factors. The next start is the mix of the last sweeps whose changes cancel
best (H. F. Walker, P. Ni, "Anderson Acceleration for Fixed-Point Iterations", SIAM J. Numer. Anal. 49, 2011), which is
GMRES by another name, for a few vectors of memory. Cost: one product a sweep; five to fifteen sweeps in common rooms.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from .sparse_rows import SparseRows

#: Sweeps at most.
MAX_SWEEPS = 200

#: Earlier steps that the acceleration looks back on.
MEMORY = 8


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
        radiosity = _accelerated(steps[-MEMORY:], changes[-MEMORY:])
    return np.maximum(radiosity, 0), irradiance, sweep + 1, residual


def _size(values: np.ndarray, areas: np.ndarray) -> float:
    """RMS of (2P, 3) values, weighted by area."""
    squares = (values.astype(np.float64) ** 2).sum(axis=1)
    return float(np.sqrt((areas * (squares[: len(areas)] + squares[len(areas) :])).sum()))


def _accelerated(steps: list[np.ndarray], changes: list[np.ndarray]) -> np.ndarray:
    """The mix of the last steps whose changes cancel best, per channel."""
    if len(steps) == 1:
        return steps[0]
    out = np.empty_like(steps[-1])
    for channel in range(3):
        last = changes[-1][:, channel].astype(np.float64)
        differences = np.stack([last - c[:, channel] for c in changes[:-1]])
        # Normal equations with a small tie: few unknowns, and nearly parallel changes must not blow up. By einsum: a
        # matrix product of this shape waits for threads longer than it works.
        normal = np.einsum("ki,li->kl", differences, differences)
        normal += np.eye(len(normal)) * (1e-10 * np.trace(normal) + 1e-300)
        mix = np.linalg.solve(normal, np.einsum("ki,i->k", differences, last))
        mixed = steps[-1][:, channel].astype(np.float64)
        for weight, step in zip(mix, steps[:-1], strict=True):
            mixed = mixed + weight * (step[:, channel] - steps[-1][:, channel])
        out[:, channel] = np.maximum(mixed, 0)
    return out
