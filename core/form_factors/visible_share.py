"""Visible share of a pair: what blockers leave of a factor that is known without them (survey 2.2.3).

Any way to get the unoccluded factor is joined to any visibility: segments between points spread over both faces, each
weighted by what it would carry, tell which share of the factor passes. An analytic factor needs fewer segments this way
than one that is sampled as well, since pairs that are wholly visible or wholly hidden come out exact.

Pairs are sampled in rounds, with independent repetitions, until the scatter of these falls below the accuracy asked
for. Cost: segments, 8 to some ten thousand per pair. Limits: what all segments of a pair miss is not seen; the error
says so, since it is never stated lower than the weight of one segment.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..visibility.segments import Visibility
from .faces import Faces
from .sampling import PatchSampler, kronecker_points

#: Independent repetitions, for the error estimate.
REPETITIONS = 8

#: Segments per pair and repetition in successive rounds.
ROUNDS = (16, 64, 256, 1024, 4096, 16384)

#: Segments in flight: about 40 MB.
BLOCK_SEGMENTS = 2**18

#: Standard error aimed at, as a share of the accuracy asked for: a matrix has thousands of factors, and the largest
#: deviation of so many, at four standard errors, is then still a third of it.
GOAL = 0.08

logger = logging.getLogger(__name__)


def visible_shares(
    environment: Environment,
    faces: Faces,
    first: np.ndarray,
    second: np.ndarray,
    factors: np.ndarray,
    visibility: Visibility,
    accuracy: float,
    seed: int | tuple[int, ...] = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pair's exchange that blockers let pass, and its standard error as a factor.

    Parameters
    ----------
    environment : Environment
    faces : Faces
        Its faces.
    first, second : (m,) int
        Faces of each pair.
    factors : (m,) float
        Unoccluded factors of the smaller face: errors are weighed by them.
    visibility : Visibility
    accuracy : float
        Error allowed to each factor.
    seed : int or tuple of int

    Returns
    -------
    shares, errors : (m,) float64
    """
    sampler = PatchSampler(environment)
    shares, errors = np.zeros(len(first)), factors.copy()
    pending = np.arange(len(first))
    for number, count in enumerate(ROUNDS):
        samples = np.zeros((REPETITIONS, len(pending)))
        table = kronecker_points(count, 4)
        for repetition in range(REPETITIONS):
            # Drawn for all pairs, so that a pair's points do not depend on which others are pending.
            shifts = np.random.default_rng((*np.atleast_1d(seed), number, repetition)).random((len(first), 4))[pending]
            step = max(1, BLOCK_SEGMENTS // count)
            for begin in range(0, len(pending), step):
                part = slice(begin, begin + step)
                pairs = pending[part]
                square = (table + shifts[part, None]) % 1
                samples[repetition, part] = _sampled(faces, sampler, first[pairs], second[pairs], square, visibility)
        shares[pending] = samples.mean(axis=0)
        scatter = samples.std(axis=0, ddof=1) / np.sqrt(REPETITIONS)
        errors[pending] = factors[pending] * np.maximum(scatter, 1 / (count * REPETITIONS))
        pending = pending[errors[pending] > GOAL * accuracy]
        if not len(pending):
            break
    else:
        if errors.max() > accuracy:
            logger.warning("Form factors are accurate to %.2g only, not %.2g: sample limit", errors.max(), accuracy)
    return shares, errors


def _sampled(faces, sampler, first, second, square, visibility):
    """Visible share (m,) from one segment for each of `square` (m, s, 4)."""
    origins = sampler(faces.owners[first], square[:, :, :2])
    targets = sampler(faces.owners[second], square[:, :, 2:])
    rays = targets - origins
    squares = np.einsum("msi,msi->ms", rays, rays)
    here = np.maximum(np.einsum("msi,mi->ms", rays, faces.normals[first]), 0)
    there = np.maximum(-np.einsum("msi,mi->ms", rays, faces.normals[second]), 0)
    # Near contact a segment stands for a disk on the other face, as in the ray-traced disks: it keeps weights finite.
    disks = np.minimum(faces.areas[first], faces.areas[second])[:, None] / square.shape[1]
    weights = here * there / np.maximum(squares * (np.pi * squares + disks), np.finfo(np.float64).tiny)
    lit = weights > 0
    seen = np.zeros(weights.shape)
    seen[lit] = visibility.visible(origins[lit], targets[lit])
    total = weights.sum(axis=1)
    return (weights * seen).sum(axis=1) / np.where(total > 0, total, 1)
