"""Root-mean-square errors from answers that are noisy themselves, with the interval that holds the true one.

Of two independent answers a and b for the same place, whose noise has mean 0, the product (v - a)(v - b) has the square
of the error of v as its mean: the noise does not add to it, as it would to the square of a difference. The interval is
that of a bootstrap over places (Efron and Tibshirani 1993, "An Introduction to the Bootstrap", chapter 14), drawn
within strata.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Resamples of the bootstrap, and the probability with which its interval should hold the truth.
RESAMPLES = 1000
CONFIDENCE = 0.95

#: Resamples done at a time.
BLOCK = 200


@dataclass(frozen=True)
class MeasuredError:
    """A relative RMS error: the estimate, the ends of its interval, and the places behind it.

    `noise` is the relative RMS difference that the reference itself still has from the truth.
    """

    error: float
    low: float
    high: float
    noise: float
    places: int


def measure(
    values: np.ndarray, halves: np.ndarray, weights: np.ndarray, strata: np.ndarray, seed: int
) -> MeasuredError:
    """Relative RMS error of values at n places.

    Parameters
    ----------
    values : (n, c) float
        What is judged; NaN where a channel says nothing.
    halves : (2, n, c) float
        Two independent answers for the same places.
    weights : (n,) float
        What each place counts.
    strata : (n,) int
        Places were drawn within these, each evenly.
    seed : int

    Raises
    ------
    ValueError
        If there is no place.
    """
    if not len(values):
        raise ValueError("no place to measure at")
    reference = halves.mean(axis=0)
    known = np.isfinite(values)
    products = np.where(known, (values - halves[0]) * (values - halves[1]), 0)
    channels = known.sum(axis=1) / values.shape[1]
    rows = np.stack(
        [
            weights * products.mean(axis=1),
            weights * np.where(known, reference, 0).mean(axis=1),
            weights * channels,
        ]
    )
    noise = np.where(known, (halves[0] - halves[1]) / 2, 0)
    generator = np.random.default_rng(seed)
    samples = np.concatenate(
        [_ratio(_resampled(rows, strata, min(BLOCK, RESAMPLES - k), generator)) for k in range(0, RESAMPLES, BLOCK)]
    )
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(samples, [tail, 1 - tail])
    mean = rows[1].sum() / rows[2].sum()
    scatter = np.sqrt((weights * (noise**2).mean(axis=1)).sum() / rows[2].sum())
    error = float(_ratio(rows.sum(axis=1)[:, None])[0])
    # The estimate may fall outside where everything hangs on one place.
    return MeasuredError(
        error, min(float(low), error), max(float(high), error), float(scatter / mean) if mean > 0 else 0.0, len(values)
    )


def _ratio(sums: np.ndarray) -> np.ndarray:
    """(k,) relative errors from sums (3, k) of products, light and weights."""
    products, light, weights = sums
    means = np.maximum(products, 0) / np.maximum(weights, 1e-300)
    return np.sqrt(means) * weights / np.where(light > 0, light, np.inf)


def _resampled(rows: np.ndarray, strata: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """(3, count) sums over as many places again, drawn anew within each stratum."""
    sums = np.zeros((len(rows), count))
    for stratum in np.unique(strata):
        members = np.nonzero(strata == stratum)[0]
        drawn = members[generator.integers(len(members), size=(count, len(members)))]
        sums += rows[:, drawn].sum(axis=2)
    return sums
