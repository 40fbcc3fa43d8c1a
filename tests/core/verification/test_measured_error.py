"""Errors measured against noisy references: the noise must not count, and the interval must hold the truth."""

import numpy as np
import pytest
from radiosity.core.verification.measured_error import measure


def places(seed, count=400, error=0.05, noise=0.05, heavy=False):
    """Values, halves and the relative RMS error of the population they were drawn from: light 2, three channels."""
    generator = np.random.default_rng(seed)
    off = generator.standard_normal((count, 1)) if not heavy else generator.exponential(1, (count, 1)) / np.sqrt(2)
    values = 2 + 2 * error * off * np.ones(3)
    halves = 2 + 2 * noise * np.sqrt(2) * generator.standard_normal((2, count, 3))
    return values, halves, np.ones(count), np.zeros(count, int)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_noise_of_the_reference_does_not_count(noise):
    # The mean of squares is what has no bias, its root is a little less.
    found = [measure(*places(seed, noise=noise), seed).error ** 2 for seed in range(40)]
    assert np.mean(found) == pytest.approx(0.05**2, rel=0.04)


def test_its_own_noise_is_told():
    measured = measure(*places(0, noise=0.04), 0)
    # The mean of two answers, each of noise 0.04 sqrt(2).
    assert measured.noise == pytest.approx(0.04, rel=0.1)


@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_interval_holds_the_truth(heavy, noise):
    inside = sum(
        m.low <= 0.05 <= m.high for m in (measure(*places(s, noise=noise, heavy=heavy), s) for s in range(100))
    )
    # 95 % of 100, less four standard errors of that count.
    assert inside >= 95 - 4 * np.sqrt(100 * 0.95 * 0.05)


def test_what_is_right_may_be_right():
    measured = measure(*places(0, error=0.0, noise=0.03), 0)
    assert measured.low == 0 and measured.high < 0.012


def test_strata_count_by_their_weights():
    values, halves, weights, strata = places(0, count=800, noise=0)
    values[400:] = 2 + 4 * (values[400:] - 2)
    strata[400:] = 1
    weights[:400], weights[400:] = 9, 1
    expected = 0.05 * np.sqrt((9 + 16) / 10)
    measured = measure(values, halves, weights, strata, 0)
    assert measured.low < expected < measured.high
    assert measured.error == pytest.approx(expected, rel=0.1)


def test_channels_that_say_nothing_are_left_out():
    values, halves, weights, strata = places(0)
    whole = measure(values, halves, weights, strata, 0)
    values[:, 2] = np.nan
    part = measure(values, halves, weights, strata, 0)
    assert part.error == pytest.approx(whole.error, rel=0.05)


def test_no_place_and_no_light():
    values, halves, weights, strata = places(0)
    with pytest.raises(ValueError, match="no light"):
        measure(values, 0 * halves, weights, strata, 0)
    with pytest.raises(ValueError, match="no place"):
        measure(np.empty((0, 3)), np.empty((2, 0, 3)), np.empty(0), np.empty(0, int), 0)
