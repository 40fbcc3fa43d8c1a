"""Aimed rays: the part of a hemisphere in which one patch is seen, sampled for a single pair (survey figure 6).

Of the rays of a whole hemisphere few meet a small or distant patch. Rays from points of the smaller face of a pair that
aim at the other alone, each weighted by its share of the projected hemisphere, count the same factor with an error
relative to it. Where faces are near the directions are spread evenly over the solid angle, else over the area: see
`segment_samples`.

Cost: rays, sixteen to some hundred thousand a pair, at a microsecond each. Limits: what all rays of a pair miss is not
seen; the error is never stated lower than the weight of one of them.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..visibility.segments import make_visibility
from .allowed_error import AIM, allowed_error
from .faces import Faces
from .hemisphere import SampledRows, hemisphere_rows
from .segment_samples import SegmentSamples
from .uncertain_pairs import Look, with_uncertain_pairs
from .visible_share import REPETITIONS, Samples, first_rounds, in_rounds

#: Round of `visible_share.ROUNDS` to begin with at least: the scatter of fewer rays is too often too low.
FIRST_ROUND = 2

#: Error of the worst factor of a row of whole hemispheres, as a share of the accuracy. Of 0.3 to 4, all took as long in
#: a Cornell box, and 0.2 to 1 in a room of 909 patches.
ROWS_SHARE = 0.5

#: Patches up to which pairs are looked at. Among more of them rows take seconds where tens of thousands of pairs would
#: take minutes: a Cornell box baked by hemispheres at 1 % took 38 s in place of 6, with no smaller error.
FEW_PATCHES = 36

logger = logging.getLogger(__name__)


def hemisphere_factors(
    environment: Environment,
    visibility: str,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    sampling: str = "low_discrepancy",
) -> SampledRows:
    """Form factors of all patches by whole hemispheres, and by aimed rays for what these leave uncertain.

    Parameters are those of `hemisphere_rows`, but `accuracy` is that of `allowed_error`. For more than `FEW_PATCHES`
    patches it is the absolute error of the worst factor of a row; and for independent rays (``random``), which are
    there to be compared with evenly spread ones.
    """
    if sampling != "low_discrepancy" or len(environment) > FEW_PATCHES:
        return hemisphere_rows(environment, accuracy, seed, threads, sampling)
    rows = hemisphere_rows(environment, ROWS_SHARE * accuracy, seed, threads)
    return with_uncertain_pairs(environment, rows, accuracy, aimed_rays(environment, accuracy, seed, threads))


def aimed_factors(
    samples: Samples, first: np.ndarray, second: np.ndarray, guesses: np.ndarray, accuracy: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Factors of the smaller face of each pair, counted by rays that aim at the other.

    Parameters
    ----------
    samples : Samples
        Whose sums, over their number, are factors.
    first, second : (m,) int
        Faces of each pair.
    guesses : (m,) float
        What the factors may be, from which the number of rays to begin with follows.
    accuracy : float
        As of `allowed_error`.
    seed : int

    Returns
    -------
    factors, errors : (m,) float64
        Errors are standard errors. They may exceed what is allowed where the largest number of rays did not suffice; a
        warning is logged.
    """
    factors, errors = np.zeros((2, len(first)))

    def judge(pairs, seen, whole, count):
        found = seen / count
        factors[pairs] = np.minimum(found.mean(axis=0), 1)
        variances = found.var(axis=0, ddof=1) / REPETITIONS
        # Known from few repetitions, the variance is drawn halfway to what is common to the pairs of this round.
        squares = np.square(factors[pairs])
        common = variances.sum() / np.maximum(squares.sum(), np.finfo(np.float64).tiny)
        one_ray = whole.mean(axis=0) / (count * count * REPETITIONS)
        errors[pairs] = np.maximum(np.sqrt((variances + common * squares) / 2), one_ray)
        return errors[pairs] > AIM * allowed_error(factors[pairs], accuracy)

    in_rounds(samples, first, second, np.maximum(first_rounds(guesses, accuracy), FIRST_ROUND), judge, seed)
    over = errors - allowed_error(factors, accuracy)
    if over.max(initial=0) > 0:
        worst = np.argmax(over)
        logger.warning("A form factor of %.2g is known to %.2g only: ray limit", factors[worst], errors[worst])
    return factors, errors


def aimed_rays(environment: Environment, accuracy: float, seed: int, threads: int) -> Look:
    """A closer look at pairs of patches, as of `uncertain_pairs`."""
    faces = Faces(environment)
    visibility = make_visibility("embree", environment, threads)
    samples = SegmentSamples(environment, faces, visibility)
    fronts, backs = (np.full(len(environment), -1) for _ in range(2))
    count = int((environment.areas > 0).sum())
    fronts[faces.owners[:count]] = np.arange(count)
    backs[faces.owners[count:]] = np.arange(count, len(faces))

    def look(first, second, guesses):
        exchange, squares = np.zeros((2, len(first)))
        before = visibility.rays
        for number, (here, there) in enumerate(((fronts, fronts), (fronts, backs), (backs, fronts), (backs, backs))):
            pairs = np.flatnonzero((here[first] >= 0) & (there[second] >= 0))
            if not len(pairs):
                continue
            one, other = here[first[pairs]], there[second[pairs]]
            found, errors = aimed_factors(samples, one, other, guesses[pairs], accuracy, (seed, number))
            smaller = np.minimum(faces.areas[one], faces.areas[other])
            exchange[pairs] += smaller * found
            squares[pairs] += np.square(smaller * errors)
        areas = environment.areas[first]
        return exchange / areas, np.sqrt(squares) / areas, visibility.rays - before

    return look
