"""Identities of form factors: reciprocity and closure, checked and repaired (survey eq. 4 to 6).

Sampled factors obey ``A_i F_ij = A_j F_ji`` and, in closed scenes, ``sum_j F_ij = 1`` only up to noise, and a row sum
that is wrong by e shifts the light of a bright room by e / (1 - reflectance). The repair first joins the two estimates
of each exchange, weighted by their precision, then makes rows sum right by scaling exchanges with one factor per patch
at either end: the change of least relative entropy that keeps reciprocity, zeros, and factors between 0 and 1.
"""

from __future__ import annotations

import numpy as np

#: Row-sum error at which closing stops: some hundred roundings, far below any method's own error.
CLOSED = 1e-13

#: Newton steps and, in each, conjugate-gradient steps. Noise of a percent takes 3 to 5 of the former; scenes whose rows
#: cannot all be closed run into the limit and keep the rest of their error, which is reported.
NEWTON_STEPS = 30
GRADIENT_STEPS = 200


def reciprocity_error(matrix: np.ndarray, areas: np.ndarray) -> float:
    """Largest ``|A_i F_ij - A_j F_ji|`` over the smaller area of the pair: the error as a form factor."""
    exchange = areas[:, None] * matrix
    smaller = np.minimum(areas[:, None], areas)
    return float((np.abs(exchange - exchange.T) / np.where(smaller > 0, smaller, np.inf)).max(initial=0))


def closure_error(matrix: np.ndarray, escaped: np.ndarray | float = 0.0, areas: np.ndarray | None = None) -> float:
    """Largest ``|sum_j F_ij + escaped_i - 1|``; patches without area do not count."""
    errors = np.abs(matrix.sum(axis=1) + escaped - 1)
    return float(errors.max(initial=0, where=True if areas is None else areas > 0))


def join_estimates(matrix: np.ndarray, areas: np.ndarray, samples: np.ndarray | None = None) -> np.ndarray:
    """Exchange areas ``A_i F_ij`` (n, n), exactly symmetric, from factors that obey reciprocity only roughly.

    Counting N_i rays from patch i, the exchange's variance is proportional to ``A_i / N_i``; its inverse is the weight
    of that estimate.

    Parameters
    ----------
    matrix : (n, n) float
    areas : (n,) float
    samples : (n,) float, optional
        Rays cast from each patch; equal when left out.
    """
    precision = np.ones(len(areas)) if samples is None else np.asarray(samples, dtype=np.float64)
    inverse = np.where(areas > 0, precision / np.where(areas > 0, areas, 1), 0)
    total = inverse[:, None] + inverse
    joined = precision[:, None] * matrix
    joined = (joined + joined.T) / np.where(total > 0, total, 1)
    joined[areas <= 0] = 0
    joined[:, areas <= 0] = 0
    return joined


def close_rows(exchange: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Exchange areas scaled by ``exp(a_i + a_j)`` so that each row sums to its area; symmetric as before.

    The factors minimize the relative entropy to the given exchange under all row sums at once, found by Newton's method
    with conjugate gradients. Zeros stay zero. Rows without any exchange are left alone.
    """
    sums = exchange.sum(axis=1)
    usable = (sums > 0) & (areas > 0)
    scale = np.zeros(len(areas))
    current = exchange
    worst = _worst_row(sums, areas, usable)
    for _ in range(NEWTON_STEPS):
        if worst <= CLOSED:
            break
        step = _newton_step(current, sums, np.where(usable, areas - sums, 0))
        # Half steps keep the convex problem descending where noise is large.
        for length in (1.0, 0.5, 0.25, 0.125):
            trial = scale + length * step.clip(-1, 1)
            factors = np.exp(trial)
            candidate = factors[:, None] * exchange * factors
            candidate_sums = candidate.sum(axis=1)
            error = _worst_row(candidate_sums, areas, usable)
            if error < worst:
                break
        else:
            break
        scale, current, sums, worst = trial, candidate, candidate_sums, error
    return current


def limit_rows(exchange: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Exchange areas scaled down, symmetrically, until no row sums to more than its area."""
    current = exchange
    for _ in range(NEWTON_STEPS):
        sums = current.sum(axis=1)
        factors = np.where(sums > areas, areas / np.where(sums > 0, sums, 1), 1)
        if np.all(factors >= 1 - CLOSED):
            break
        current = current * np.minimum(factors[:, None], factors)
    return current


def repair(matrix: np.ndarray, areas: np.ndarray, closed: bool, samples: np.ndarray | None = None) -> np.ndarray:
    """Form factors that obey reciprocity exactly, and closure too where the scene is closed.

    Parameters
    ----------
    matrix : (n, n) float
        Factors with errors small against 1.
    areas : (n,) float
        Patches of area 0 get factors 0.
    closed : bool
        Whether rows sum to 1; else they are only kept from exceeding it.
    samples : (n,) float, optional
        Rays cast from each patch, the weights of joining.

    Returns
    -------
    (n, n) float64

    References
    ----------
    .. [1] Larsen, Howell, "Least-Squares Smoothing of Direct-Exchange Areas in Zonal Analysis", Journal of Heat
       Transfer 108, 1986; with relative entropy in place of squares, which keeps signs.
    """
    exchange = join_estimates(matrix, areas, samples)
    exchange = close_rows(exchange, areas) if closed else limit_rows(exchange, areas)
    return exchange / np.where(areas > 0, areas, 1)[:, None]


def _worst_row(sums, areas, usable):
    return float((np.abs(sums - areas) / np.where(usable, areas, 1)).max(initial=0, where=usable))


def _newton_step(exchange, sums, missing):
    """Solve ``(diag(sums) + exchange) step = missing`` by conjugate gradients; semidefinite systems are fine."""
    diagonal = np.where(sums > 0, sums, 1)
    step, rest = np.zeros_like(missing), missing.copy()
    shaped = rest / diagonal
    direction, energy = shaped.copy(), rest @ shaped
    target = energy * 1e-24
    for _ in range(GRADIENT_STEPS):
        if energy <= target:
            break
        image = diagonal * direction + exchange @ direction
        curvature = direction @ image
        if curvature <= 0:
            break
        length = energy / curvature
        step += length * direction
        rest -= length * image
        shaped = rest / diagonal
        energy, before = rest @ shaped, energy
        direction = shaped + energy / before * direction
    return step
