"""The repair of form factors: both identities, and no nearer matrix that meets them."""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity import core
from radiosity.core.form_factors import identities

from tests.reference_cases import form_factor_cases, in_order, polygons_of

CASES = form_factor_cases()


def invented(generator, count, noise):
    """Noisy factors, areas, samples, and the true factors of a closed scene with some zeros.

    Noise leaves no factor at 0 that is not, so that the zeros allow both identities.
    """
    while True:
        exchange = np.triu(generator.random((count, count)) * (generator.random((count, count)) < 0.8), 1)
        exchange += exchange.T
        areas = exchange.sum(axis=1)
        if areas.min() > 0:
            truth = exchange / areas[:, None]
            noisy = truth * (1 + noise * generator.uniform(-1, 1, truth.shape)).clip(0.01)
            return noisy, areas, generator.integers(1, 100, count).astype(float), truth


def change(mended, noisy, areas, samples):
    """What the repair claims to make least: squared changes over the variance of each factor."""
    expected = identities.join_estimates(noisy, areas, samples) / areas[:, None]
    squares = samples[:, None] * (mended - noisy) ** 2
    return (squares[expected > 0] / expected[expected > 0]).sum()


def least_change_by_trial(noisy, areas, samples, closed):
    """Least change of all, by solving the conditions of optimality for every set of zeros and of full rows."""
    count = len(areas)
    pairs = list(combinations(range(count), 2))
    incidence = np.array([[float(row in pair) for pair in pairs] for row in range(count)])
    full_rows = [range(count)] if closed else [c for k in range(count + 1) for c in combinations(range(count), k)]
    weights = samples / areas
    here, there = np.array(pairs).T
    exchange = areas[:, None] * noisy
    best = np.inf
    for zeros, rows in product(product([False, True], repeat=len(pairs)), full_rows):
        # Of two estimates with weights the mean costs least; its variance is in proportion to itself.
        total = weights[here] + weights[there]
        mean = (weights[here] * exchange[here, there] + weights[there] * exchange[there, here]) / total
        variance = np.where(zeros, 0, mean) / total
        active = incidence[list(rows)]
        wanted = areas[list(rows)] - active @ np.where(zeros, 0, mean)
        multipliers = np.linalg.lstsq((active * variance) @ active.T, wanted, rcond=None)[0]
        values = np.where(zeros, 0, mean) + variance * (active.T @ multipliers)
        sums = incidence @ values
        if values.min() < -1e-12 or (sums > areas * (1 + 1e-9)).any():
            continue
        if closed and (sums < areas * (1 - 1e-9)).any():
            continue
        candidate = np.zeros((count, count))
        candidate[here, there] = candidate[there, here] = values
        best = min(best, change(candidate / areas[:, None], noisy, areas, samples))
    return best


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("noise", [0.1, 3.0])
def test_no_matrix_that_meets_both_identities_is_nearer(closed, noise):
    generator = np.random.default_rng(int(10 * noise))
    held = 0
    for _ in range(24 if closed else 4):
        noisy, areas, samples, _ = invented(generator, 4, noise)
        mended = identities.repair(noisy, areas, closed, samples)
        least = least_change_by_trial(noisy, areas, samples, closed)
        # Some roundings, in squares of standard errors.
        assert change(mended, noisy, areas, samples) == pytest.approx(least, rel=1e-9, abs=1e-12)
        assert identities.reciprocity_error(mended, areas) < 1e-14
        assert mended.min() >= 0 and mended.sum(axis=1).max() <= 1 + 1e-12
        assert not closed or identities.closure_error(mended) < 1e-12
        held += int(((mended == 0) & (noisy + noisy.T > 0)).sum())
    # Only noise as large as the factors drives some of them against their bound, which is then met exactly.
    assert held == 0 if noise < 1 or not closed else held > 0


def test_no_step_within_the_identities_makes_the_change_smaller():
    """On a matrix too large to try all sets of zeros: random steps that keep symmetry, row sums and zeros."""
    generator = np.random.default_rng(4)
    noisy, areas, samples, _ = invented(generator, 40, 0.5)
    mended = identities.repair(noisy, areas, True, samples)
    least = change(mended, noisy, areas, samples)
    exchange = areas[:, None] * mended
    steps = 0
    for _ in range(400):
        a, b, c, d = generator.choice(40, 4, replace=False)
        size = 1e-3 * generator.standard_normal() * min(exchange[a, b], exchange[b, c], exchange[c, d], exchange[d, a])
        moved = exchange.copy()
        for (i, j), sign in zip(((a, b), (b, c), (c, d), (d, a)), (1, -1, 1, -1), strict=True):
            moved[i, j] = moved[j, i] = moved[i, j] + sign * size
        # Each of the four patches gains as much as it loses.
        assert np.abs(moved.sum(axis=1) - areas).max() < 1e-12
        if size != 0:
            assert change(moved / areas[:, None], noisy, areas, samples) > least
            steps += 1
    assert steps > 100


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(3, 30))
def test_repair_meets_both_identities_with_a_small_change(seed, count):
    generator = np.random.default_rng(seed)
    sizes = 10 ** generator.uniform(-2, 0, count)
    exchange = generator.random((count, count)) * (generator.random((count, count)) < 0.7)
    exchange = np.outer(sizes, sizes) * (exchange + exchange.T)
    np.fill_diagonal(exchange, 0)
    # A patch as large as what it exchanges sends everything to others.
    areas = exchange.sum(axis=1)
    truth = exchange / np.where(areas > 0, areas, 1)[:, None]
    noisy = truth * (1 + 0.02 * generator.uniform(-1, 1, truth.shape))
    mended = identities.repair(noisy, areas, closed=True)
    assert np.array_equal(mended == 0, noisy == 0)
    assert 0 <= mended.min() and mended.max() <= 1 + 1e-12
    assert identities.reciprocity_error(mended, areas) < 1e-12
    assert identities.closure_error(mended, areas=areas) < 1e-9
    # The correction is of the noise's size, and brings the whole closer to the truth than the noise left it.
    assert np.abs(mended - truth).max() < 0.2 * truth.max()


def test_repair_brings_noisy_factors_closer_to_the_truth():
    generator = np.random.default_rng(0)
    noisy, areas, samples, truth = invented(generator, 60, 0)
    # Noise as counting makes it, so that the weights are the right ones.
    deviations = np.sqrt(truth / (1e4 * samples[:, None]))
    ratios = []
    for _ in range(20):
        noisy = np.maximum(truth + deviations * generator.standard_normal(truth.shape), 0)
        mended = identities.repair(noisy, areas, True, samples)
        ratios.append(change(mended, truth, areas, samples) / change(noisy, truth, areas, samples))
    # Joining halves the n^2 numbers that err, closing takes n more: (n (n - 1) / 2 - n) of n (n - 1) remain.
    assert np.mean(ratios) == pytest.approx(0.5 - 1 / 59, abs=0.02)


def test_repair_of_true_factors_changes_nothing():
    case = CASES["enc-box-7-3-2"]
    truth = np.array(case["matrix"]["F"])
    polygons, _ = polygons_of(case)
    areas = in_order(case, core.Environment.from_polygons(polygons).areas, case["matrix"]["order"])
    np.testing.assert_allclose(identities.repair(truth, areas, closed=True), truth, atol=1e-14)


def test_joining_trusts_the_patch_with_more_rays_per_area():
    areas = np.array([1.0, 100.0])
    noisy = np.array([[0.0, 0.5], [0.1, 0.0]])
    # The small patch says that 0.5 passes, the large one 10: with equal rays the former knows 100 times better.
    exchange = identities.join_estimates(noisy, areas)
    assert exchange[0, 1] == exchange[1, 0] == pytest.approx((0.5 * 100 + 10) / 101)
    assert identities.join_estimates(noisy, areas, np.array([1, 1000]))[0, 1] == pytest.approx((50 + 10_000) / 1100)


def test_open_rows_are_kept_from_exceeding_one():
    areas = np.ones(3)
    noisy = np.array([[0, 0.7, 0.4], [0.7, 0, 0.2], [0.4, 0.2, 0]])
    mended = identities.repair(noisy, areas, closed=False)
    assert mended.sum(axis=1).max() <= 1 + 1e-12
    np.testing.assert_allclose(mended, mended.T, atol=1e-15)
    assert np.array_equal(identities.repair(noisy / 2, areas, closed=False), noisy / 2)


def test_rows_that_zeros_keep_from_closing_do_not_exceed_one():
    # Two plates of unequal areas that see nothing but each other cannot both send everything to the other.
    areas = np.array([2.0, 3.0])
    mended = identities.repair(np.array([[0, 0.5], [1, 0]]), areas, closed=True)
    assert np.isfinite(mended).all() and mended.max() <= 1 + 1e-12
    assert identities.reciprocity_error(mended, areas) < 1e-15
