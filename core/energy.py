"""Energy balance: what is emitted is absorbed by patches or escapes; the rest is the error of the solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EnergyBalance:
    """Powers (c,) in W when areas are in square meters and radiosity in W/m2.

    Attributes
    ----------
    emitted, absorbed, escaped : (c,) float64
    absorbed_share : float
        Absorbed over emitted power, all channels together; 0 without emission.
    error : float
        ``|emitted - absorbed - escaped| / emitted`` in the worst channel.
    """

    emitted: np.ndarray
    absorbed: np.ndarray
    escaped: np.ndarray
    absorbed_share: float
    error: float


def energy_balance(
    form_factors: np.ndarray,
    areas: np.ndarray,
    reflectance: np.ndarray,
    emission: np.ndarray,
    radiosity: np.ndarray,
) -> EnergyBalance:
    """Follow the power of a solution.

    Absorbed is ``sum A (1 - rho) H`` with ``H = F @ B``; escaped is the share of each row that reaches no patch, so the
    balance closes only when the solver has converged *and* the matrix is reciprocal.

    Parameters
    ----------
    form_factors : (n, n) float
    areas : (n,) float
    reflectance, emission, radiosity : (n, c) or (n,) float
        Any that broadcast against each other.

    Returns
    -------
    EnergyBalance
    """
    matrix = np.asarray(form_factors, dtype=np.float64)
    reflectance, emission, radiosity = (
        a[:, None] if a.ndim == 1 else a
        for a in (np.asarray(v, dtype=np.float64) for v in (reflectance, emission, radiosity))
    )
    areas = np.asarray(areas, dtype=np.float64)
    emitted = areas @ np.broadcast_to(emission, radiosity.shape)
    absorbed = areas @ ((1 - reflectance) * (matrix @ radiosity))
    escaped = (areas * (1 - matrix.sum(axis=1))) @ radiosity
    missing = np.abs(emitted - absorbed - escaped)
    lit = emitted > 0
    # Light out of nothing is an infinite error, darkness none.
    errors = np.where(lit, missing / np.where(lit, emitted, 1), np.where(missing > 0, np.inf, 0))
    total = emitted.sum()
    return EnergyBalance(
        emitted=emitted,
        absorbed=absorbed,
        escaped=escaped,
        absorbed_share=float(absorbed.sum() / total) if total > 0 else 0.0,
        error=float(errors.max(initial=0)),
    )
