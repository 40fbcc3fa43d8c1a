"""Visible share of a pair: what blockers leave of a factor that is known without them (survey 2.2.3).

Any way to get the unoccluded factor is joined to any visibility: segments between points of both faces, each weighted
by what it would carry, tell which share of the factor passes. An analytic factor needs fewer segments this way than one
that is sampled as well, since pairs that are wholly visible or wholly hidden come out exact. Where the points lie and
what they weigh is up to `Samples`: `segment_samples` holds the plain ones, and methods with a kernel of their own bring
their own.

Pairs are sampled in rounds, with independent repetitions, until the scatter of these falls below the error allowed. The
first round has the fewest segments that can tell that much of a pair that is wholly visible. Cost: segments, 16 to some
hundred thousand per pair. Limits: what all segments of a pair miss is not seen; the error says so, since it is never
stated lower than the weight of one segment.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

import numpy as np

from .allowed_error import AIM, allowed_error
from .scatter import pooled_shares, steadied

#: Independent repetitions, for the error estimate.
REPETITIONS = 8

#: Segments per pair and repetition in successive rounds.
ROUNDS = (2, 8, 32, 128, 512, 2048, 8192, 32768)

#: Segments in flight: about 40 MB.
BLOCK_SEGMENTS = 2**17

logger = logging.getLogger(__name__)


class Samples(Protocol):
    """Segments between pairs of faces, and what they carry."""

    def __call__(
        self, first: np.ndarray, second: np.ndarray, count: int, shifts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What about `count` segments of each pair carry together that are visible, and all of them.

        Parameters
        ----------
        first, second : (m,) int
            Faces of each pair.
        count : int
        shifts : (m, 4) float
            Numbers between 0 and 1 that move the points of each pair at random.

        Returns
        -------
        seen, whole : (m,) float64
        """


def visible_shares(
    samples: Samples,
    first: np.ndarray,
    second: np.ndarray,
    factors: np.ndarray,
    accuracy: float,
    seed: int | tuple[int, ...] = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pair's exchange that blockers let pass, and its standard error as a factor.

    Parameters
    ----------
    samples : Samples
    first, second : (m,) int
        Faces of each pair.
    factors : (m,) float
        Unoccluded factors of the smaller face: errors are weighed by them.
    accuracy : float
        As of `allowed_error`.
    seed : int or tuple of int

    Returns
    -------
    shares, errors : (m,) float64
    """
    shares, errors = np.ones(len(first)), np.zeros(len(first))

    def judge(pairs, seen, whole, count):
        found, scatter = pooled_shares(seen, whole)
        shares[pairs] = found
        errors[pairs] = factors[pairs] * np.maximum(steadied(found, scatter), 1 / (count * REPETITIONS))
        return errors[pairs] > AIM * allowed_error(shares[pairs] * factors[pairs], accuracy)

    in_rounds(samples, first, second, first_rounds(factors, accuracy), judge, seed)
    over = errors - allowed_error(shares * factors, accuracy)
    if over.max(initial=0) > 0:
        worst = np.argmax(over)
        logger.warning(
            "A form factor of %.2g is known to %.2g only: sample limit", shares[worst] * factors[worst], errors[worst]
        )
    return shares, errors


def in_rounds(
    samples: Samples,
    first: np.ndarray,
    second: np.ndarray,
    rounds: np.ndarray,
    judge: Callable[[np.ndarray, np.ndarray, np.ndarray, int], np.ndarray],
    seed: int | tuple[int, ...],
) -> None:
    """Sample pairs with more and more segments.

    Parameters
    ----------
    samples : Samples
    first, second : (m,) int
        Faces of each pair.
    rounds : (m,) int
        In `ROUNDS`, that in which each pair is first sampled.
    judge : callable
        ``judge(pairs, seen, whole, count)`` takes some of the pairs (k,) and what their repetitions of `count` segments
        found, (r, k) each, and tells which of them (k,) bool go on to the next round.
    seed : int or tuple of int
    """
    pending = np.zeros(0, dtype=np.int64)
    for number, count in enumerate(ROUNDS):
        pending = np.union1d(pending, np.flatnonzero(rounds == number))
        if not len(pending):
            continue
        seen, whole = np.zeros((2, REPETITIONS, len(pending)))
        for repetition in range(REPETITIONS):
            # Drawn for all pairs, so that a pair's points do not depend on which others are pending.
            generator = np.random.default_rng((*np.atleast_1d(seed), number, repetition))
            shifts = generator.random((len(first), 4))[pending]
            step = max(1, BLOCK_SEGMENTS // count)
            for begin in range(0, len(pending), step):
                part = slice(begin, begin + step)
                pairs = pending[part]
                seen[repetition, part], whole[repetition, part] = samples(
                    first[pairs], second[pairs], count, shifts[part]
                )
        pending = pending[judge(pending, seen, whole, count)]


def first_rounds(factors: np.ndarray, accuracy: float) -> np.ndarray:
    """(m,) round in which each pair is first sampled: one segment of it must not weigh more than its error."""
    wanted = factors / (AIM * allowed_error(factors, accuracy) * REPETITIONS)
    return np.minimum(np.searchsorted(ROUNDS, wanted), len(ROUNDS) - 1)
