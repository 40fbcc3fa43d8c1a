"""Identities of form factors: reciprocity and closure, checked and repaired (survey eq. 4 to 6).

Sampled factors obey ``A_i F_ij = A_j F_ji`` and, in closed scenes, ``sum_j F_ij = 1`` only up to noise, and a row sum
that is wrong by e shifts the light of a bright room by e / (1 - reflectance). The repair restores both at once by the
change of factors that is least in

    sum over i, j of  N_i (F'_ij - F_ij)^2 / f_ij,

that is in squares of standard errors: a factor f counted with N_i rays has the variance f (1 - f) / N_i, and for f
stands what both ends of the pair together say. Factors stay within 0 and 1, and those that are 0 in both directions
stay 0. Well-known factors, and small ones, are changed least.

Reciprocity alone joins the two estimates of an exchange, each weighted by its precision ``p_i = N_i / A_i``. Closure
then asks for one multiplier m_i per patch: ``A_i F'_ij = J_ij max(0, 1 + (m_i + m_j) / (p_i + p_j))`` with the joined
J. They solve a symmetric positive system of n equations, again whenever another set of factors is held at 0. In open
scenes rows may sum to less than 1, and only those that would exceed it have a multiplier.

Cost: n^2 for each step of conjugate gradients, ten to thirty for each of two to four systems.
"""

from __future__ import annotations

import numpy as np

#: Rows compared at once: temporaries stay in the cache up to some thousand patches.
BLOCK_ROWS = 16

#: Row-sum error at which closing stops: some hundred roundings, far below any method's own error.
CLOSED = 1e-13

#: Systems solved, and steps of conjugate gradients for each. Noise of a percent takes 2 of the former. Where rows can
#: not all be closed, because of zeros, multipliers grow without end; the rest of the error is reported.
NEWTON_STEPS = 30
GRADIENT_STEPS = 200

#: Halvings of a step that goes beyond the best place on its way, because factors reach 0 there.
HALVINGS = 30

#: Part of each diagonal element that is added to it: systems are singular where patches fall into two groups that see
#: only each other. The next step makes good what it spoils.
REGULARITY = 1e-6

#: Part of the slope at the start of a step by which the slope at its end may be off for rounding.
ROUNDING = 1e-3

#: Part of the slope at the start that is left at the end of a step, however long, where rows cannot be closed.
UNCHANGED = 1 - 1e-3


def reciprocity_error(matrix: np.ndarray, areas: np.ndarray) -> float:
    """Largest ``|A_i F_ij - A_j F_ji|`` over the smaller area of the pair: the error as a form factor."""
    worst = 0.0
    for begin in range(0, len(areas), BLOCK_ROWS):
        # Pairs count once: those with rows before the block were compared there.
        rows, rest = slice(begin, begin + BLOCK_ROWS), slice(begin, None)
        differences = areas[rows, None] * matrix[rows, rest] - areas[rest] * matrix[rest, rows].T
        smaller = np.minimum(areas[rows, None], areas[rest])
        worst = max(worst, (np.abs(differences) / np.where(smaller > 0, smaller, np.inf)).max(initial=0))
    return float(worst)


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
    counts = np.ones(len(areas)) if samples is None else np.asarray(samples, dtype=np.float64)
    precision = precision_of(areas, samples)
    total = precision[:, None] + precision
    joined = counts[:, None] * matrix
    joined = (joined + joined.T) / np.where(total > 0, total, 1)
    joined[areas <= 0] = 0
    joined[:, areas <= 0] = 0
    return joined


def nearest_exchange(exchange: np.ndarray, variances: np.ndarray, areas: np.ndarray, closed: bool) -> np.ndarray:
    """Exchange areas nearest to given ones whose rows sum to the patches' areas.

    Least is the sum of squared changes over variances. Found in its dual, of which the gradient is what rows lack, by
    Newton's method; the step is halved until the gradient no longer opposes it, so that each one improves.

    Parameters
    ----------
    exchange : (n, n) float
        Symmetric, 0 or above.
    variances : (n, n) float
        Symmetric; above 0 where there is exchange, else 0, which keeps zeros.
    areas : (n,) float
    closed : bool
        Whether rows sum to the areas; else to no more. Rows without any exchange are left alone.

    Returns
    -------
    (n, n) float64
        Symmetric, 0 or above.
    """
    scale = np.where(areas > 0, areas, 1)
    current, missing = exchange, areas - exchange.sum(axis=1)
    usable = (areas > 0) & (missing < areas)
    multipliers = np.zeros(len(areas))
    for _ in range(NEWTON_STEPS):
        # A row that may sum to less is pushed down, never up.
        free = usable & (closed | (multipliers < 0) | (missing < 0))
        gap = np.where(free, missing, 0)
        if (np.abs(gap) / scale).max(initial=0) <= CLOSED:
            break
        step = _newton_step(np.where(current > 0, variances, 0), free, gap)
        for halving in range(HALVINGS):
            trial = multipliers + step * 0.5**halving
            if not closed:
                trial = np.minimum(trial, 0)
            # In place: in large scenes fresh pages for each of the terms take longer than the sum itself.
            candidate = trial[:, None] + trial
            candidate *= variances
            candidate += exchange
            np.maximum(candidate, 0, out=candidate)
            rest, moved = areas - candidate.sum(axis=1), trial - multipliers
            # The dual is concave: a step at whose end the slope still points ahead has climbed. A whole step among the
            # same zeros ends where the slope is 0.
            before, after = moved @ missing, moved @ rest
            if after >= -ROUNDING * before:
                break
        else:
            break
        multipliers, current, missing = trial, candidate, rest
        if halving == 0 and after > UNCHANGED * before:
            break
    return current


def repair(
    matrix: np.ndarray,
    areas: np.ndarray,
    closed: bool,
    samples: np.ndarray | None = None,
    variances: np.ndarray | None = None,
) -> np.ndarray:
    """Form factors that obey reciprocity exactly, and closure too where the scene is closed, with the least change.

    Parameters
    ----------
    matrix : (n, n) float
        Factors, 0 or above, with errors small against 1.
    areas : (n,) float
        Patches of area 0 get factors 0.
    closed : bool
        Whether rows sum to 1; else they are only kept from exceeding it.
    samples : (n,) float, optional
        Rays cast from each patch, which weigh its changes; equal when left out.
    variances : (n, n) float, optional
        Of the exchange areas that both ends of a pair tell together, where they are known better than by the number of
        rays.

    Returns
    -------
    (n, n) float64

    References
    ----------
    .. [1] Larsen, Howell, "Least-Squares Smoothing of Direct-Exchange Areas in Zonal Analysis", Journal of Heat
       Transfer 108, 1986; with variances as weights, and bounds.
    """
    exchange = join_estimates(matrix, areas, samples)
    if variances is None:
        precision = precision_of(areas, samples)
        total = precision[:, None] + precision
        variances = exchange / np.where(total > 0, total, 1)
    else:
        variances = np.where(exchange > 0, variances, 0)
    mended = nearest_exchange(exchange, variances, areas, closed)
    if closed and (mended.sum(axis=1) > areas * (1 + CLOSED * len(areas))).any():
        # Rows that cannot all be closed must not exceed 1 for it.
        mended = nearest_exchange(exchange, variances, areas, False)
    return mended / np.where(areas > 0, areas, 1)[:, None]


def precision_of(areas: np.ndarray, samples: np.ndarray | None) -> np.ndarray:
    """Inverse variance (n,) of what each patch's rays tell, per unit of exchange; 0 without area."""
    counts = np.ones(len(areas)) if samples is None else np.asarray(samples, dtype=np.float64)
    return np.where(areas > 0, counts / np.where(areas > 0, areas, 1), 0)


def _newton_step(slopes, free, missing):
    """Solve ``(diag(row sums) + slopes) step = missing`` for the free rows by conjugate gradients."""
    sums = slopes.sum(axis=1)
    diagonal = np.where(sums > 0, sums, 1)
    step, rest = np.zeros_like(missing), np.where(sums > 0, missing, 0)
    shaped = rest / diagonal
    direction, energy = shaped.copy(), rest @ shaped
    target = energy * 1e-24
    for _ in range(GRADIENT_STEPS):
        if energy <= target:
            break
        image = np.where(free, (1 + REGULARITY) * diagonal * direction + slopes @ direction, 0)
        length = energy / (direction @ image)
        step += length * direction
        rest -= length * image
        shaped = rest / diagonal
        energy, before = rest @ shaped, energy
        direction = shaped + energy / before * direction
    return step
