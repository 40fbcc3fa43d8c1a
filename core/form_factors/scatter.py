"""Scatter: what independent repetitions of a sampled share say about the error of its mean.

A share, such as the visible part of a factor, is the ratio of two sampled sums. Its mean over repetitions of few points
each is off to one side however many repetitions there are; the ratio of the sums over all of them is off by as much
less as there are repetitions.

Known from few repetitions, the errors of many shares scatter themselves, and sampling that stops as soon as the error
is small stops where it is so by luck. So each is drawn to what all have in common.
"""

from __future__ import annotations

import numpy as np

#: Classes of factors that count as alike, each of a fourth of the one before: the last holds all below 4e-6.
CLASSES = 10


def pooled_shares(seen: np.ndarray, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ratios of sums over repetitions, 1 where the whole is 0, and their standard errors.

    Parameters
    ----------
    seen, whole : (r, ...) float
        What each of r repetitions found of the part and of the whole.

    Returns
    -------
    shares, errors : (...) float64

    References
    ----------
    .. [1] Cochran, "Sampling Techniques", 3rd ed. 1977, section 6.4: the variance of a ratio.
    """
    count, total = len(whole), whole.sum(axis=0)
    known = np.where(total > 0, total, 1)
    shares = np.where(total > 0, seen.sum(axis=0) / known, 1)
    # Residuals sum to 0, so that their scatter about 0 is the one about their mean.
    residuals = seen - shares * whole
    return shares, np.sqrt(np.square(residuals).sum(axis=0) * count / (count - 1)) / known


def steadied(shares: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Standard errors (m,) of shares, drawn halfway to what is common to all that were sampled alike.

    A share s has a variance in proportion to s (1 - s).
    """
    expected = shares * (1 - shares)
    total = expected.sum()
    common = np.square(errors).sum() / total if total > 0 else 0.0
    return np.sqrt((np.square(errors) + common * expected) / 2)


def steadied_by_class(variances: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Variances (r, n), known from few repetitions, drawn halfway to the mean variance per factor of their like.

    The largest of a thousand variances of three degrees of freedom each would else be five times the true one. Alike
    are factors of a row that differ by less than 4: those of neighbors vary much more than those of distant patches.
    """
    classes = (np.log2(np.maximum(factors, 4.0**-CLASSES)) / -2).astype(np.int64).clip(0, CLASSES - 1)
    classes += np.arange(len(factors))[:, None] * CLASSES
    sums, spread = (np.bincount(classes.ravel(), a.ravel(), len(factors) * CLASSES) for a in (factors, variances))
    common = spread / np.where(sums > 0, sums, 1)
    return (variances + common[classes] * factors) / 2
