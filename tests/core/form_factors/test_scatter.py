"""Ratios of sampled sums: unbiased by pooling, with errors that hold."""

import numpy as np
import pytest
from radiosity.core.form_factors.scatter import pooled_shares, steadied


def draws(repetitions, points, pairs, share, seed=3):
    """Parts and wholes (r, m) of ratios whose weight goes with what is seen, so that means of ratios are biased."""
    generator = np.random.default_rng(seed)
    weights = generator.exponential(size=(repetitions, points, pairs)) ** 2
    passed = generator.random(weights.shape) < np.where(weights > 2, share, share / 2)
    return (weights * passed).sum(axis=1), weights.sum(axis=1)


def test_pooled_ratio_is_nearer_than_the_mean_of_ratios():
    exact = np.divide(*(a.sum() for a in draws(8, 200, 4000, 0.8, seed=1)))
    seen, whole = draws(8, 4, 4000, 0.8)
    pooled, _ = pooled_shares(seen, whole)
    assert abs(pooled.mean() - exact) < 0.25 * abs((seen / whole).mean() - exact)


def test_steadied_errors_leave_a_third_as_many_beyond_three_of_them():
    exact = np.divide(*(a.sum() for a in draws(8, 200, 4000, 0.8, seed=1)))
    shares, errors = pooled_shares(*draws(8, 32, 4000, 0.8))
    raw, steady = ((np.abs(shares - exact) > 3 * e).mean() for e in (errors, steadied(shares, errors)))
    # Of Student's distribution of 7 degrees of freedom 2 % are beyond three, of these skewed ones more.
    assert raw > 0.02 and steady < raw / 3


def test_nothing_sampled_counts_as_visible():
    shares, errors = pooled_shares(np.zeros((8, 2)), np.array([[0.0, 1]] * 8))
    assert shares.tolist() == [1, 0] and errors.tolist() == [0, 0]
    assert steadied(shares, errors) == pytest.approx(0)
