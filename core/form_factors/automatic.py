"""Automatic choice: each pair of patches by the method that reaches the accuracy for least, as measured.

Pairs that no third polygon can part take the contour integral, exact where digits count and from few points where a
bounded error allows it; in a convex room these are all, and no ray is traced. What may be blocked is clipped exactly,
as long as that costs less than rays do: pairs are clipped one by one, and their cost rises slowly with the accuracy,
while rays serve a whole row at once and cost nearly the square of it. Clipped factors keep the accuracy as a bound,
those of rays as a standard error.

Choose it unless a method is wanted by name. Cost: that of what it chooses, and the test for blockers, three products of
n x n matrices; rays leave only from patches of which a pair may be blocked. Limits: beyond `MOST_PATCHES` all pairs
take rays; so do blocked pairs where they are many.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from .clipped_quadrature import ClippedQuadrature
from .contour_integral import contour_rows
from .faces import Faces, smaller_first
from .hemisphere import SampledRows, hemisphere_rows
from .pair_rows import blockable_faces

#: Accuracy from which on the contour integral samples pairs that are far apart, with bounded error. Exact factors cost
#: three times as much.
FAST_ACCURACY = 1e-5

#: Share of the accuracy that it is asked for then. Errors of one sign add up over a row: with all of the accuracy, rows
#: of a convex room of 1,014 patches were off by 3 times the accuracy; with this, by 0.005 of it, for 1.2 s in place of
#: 0.4 s.
FAST_SHARE = 0.01

#: Patches beyond which pairs are not looked at one by one.
MOST_PATCHES = 4096

#: Seconds at an accuracy of 1e-4 of a clipped pair and of a row of rays, and the powers of 1 / accuracy by which they
#: grow. Measured on 2 cores: the Cornell box's 233 blocked pairs took 0.5, 0.9 and 6.6 s for 1e-3, 1e-4 and 1e-6, its
#: 33 rows of rays 0.6 and 33 s for 1e-3 and 1e-4. Pairs took 1 to 15 ms in other rooms.
CLIPPED_SECONDS, CLIPPED_GROWTH = 0.004, 0.44
ROW_SECONDS, ROW_GROWTH = 1.0, 1.7

#: Seconds that clipping may take where rays would take less: its errors have a bound, and no blocker is missed.
CLIPPED_ALLOWANCE = 1.0

logger = logging.getLogger(__name__)


def automatic_rows(
    environment: Environment, accuracy: float, seed: int = 0, threads: int = 0
) -> tuple[SampledRows, dict[str, int]]:
    """Form factors of all patches, and how many pairs each method computed, or rows where it was the hemisphere.

    Parameters
    ----------
    environment : Environment
    accuracy : float
        Error wanted of each factor; a standard error where rays are cast.
    seed, threads : int
        Of the rays, where there are any.

    Raises
    ------
    MissingRayEngineError
        If rays are needed and cannot be traced on this platform.
    """
    count = len(environment)
    if count > MOST_PATCHES:
        return hemisphere_rows(environment, accuracy, seed, threads), {"hemisphere": count}
    free = contour_rows(environment, "none", FAST_SHARE * accuracy, fast=accuracy >= FAST_ACCURACY)
    blocked = _blockable_patches(environment) & (free.matrix > 0)
    pairs = int(blocked.sum()) // 2
    counts = {"contour_integral": count * (count - 1) // 2 - pairs}
    if not pairs:
        return free, counts
    rows = blocked.any(axis=1)
    if _clipping_pays(pairs, int(rows.sum()), accuracy):
        return _clipped(environment, free, blocked, accuracy), {**counts, "point_to_polygon": pairs}
    return _cast(environment, free, blocked, accuracy, seed, threads), {**counts, "hemisphere": int(rows.sum())}


def _blockable_patches(environment):
    """(n, n) bool: pairs of patches that something may stand between."""
    faces = Faces(environment)
    first, second = np.nonzero(blockable_faces(faces))
    blocked = np.zeros((len(environment), len(environment)), dtype=bool)
    blocked[faces.owners[first], faces.owners[second]] = True
    return blocked


def _clipping_pays(pairs, rows, accuracy):
    """Whether exact clipping of pairs costs less than rays for all rows, or little in any case."""
    finer = 1e-4 / accuracy
    clipped = pairs * CLIPPED_SECONDS * finer**CLIPPED_GROWTH
    return clipped <= max(rows * ROW_SECONDS * finer**ROW_GROWTH, CLIPPED_ALLOWANCE)


def _cast(environment, free, blocked, accuracy, seed, threads):
    """Rows of the contour integral with blocked pairs replaced by those of rays, which only their patches cast."""
    rows = blocked.any(axis=1)
    cast = hemisphere_rows(environment, accuracy, seed, threads, wanted=rows)
    matrix = np.where(blocked, cast.matrix, free.matrix)
    rest = np.maximum(1 - matrix.sum(axis=1), 0)
    # That nothing escapes is known best from the rays; how much does, from the better factors.
    tight = rows & (cast.escaped <= accuracy + cast.leaks)
    return SampledRows(
        matrix,
        np.where(tight, cast.escaped, rest),
        np.maximum(np.where(rows, cast.errors, 0), free.errors),
        np.where(rows, cast.samples, free.samples),
        cast.rays,
        np.where(rows, cast.leaks, 0),
    )


def _clipped(environment, free, blocked, accuracy):
    """Rows of the contour integral with blocked pairs replaced by exactly clipped ones."""
    areas = environment.areas
    first, second = np.nonzero(np.triu(blocked))
    # Points go to the smaller patch, whose factor is the larger one: reciprocity carries it over, with less error.
    receivers, sources = smaller_first(areas, first, second)
    quadrature = ClippedQuadrature(environment)
    values, changes = quadrature.pairs(receivers, sources, np.full(len(receivers), accuracy))
    matrix, errors, losses = free.matrix.copy(), free.errors.copy(), np.zeros(len(environment))
    matrix[receivers, sources] = values
    matrix[sources, receivers] = values * areas[receivers] / areas[sources]
    for ends, ratio in ((receivers, 1.0), (sources, areas[receivers] / areas[sources])):
        np.maximum.at(errors, ends, changes * ratio)
        np.add.at(losses, ends, changes * ratio)
    if errors.max() > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: cell limit", errors.max(), accuracy)
    # What a row's factors together may be off, so that a closed environment is known as one.
    escaped, leaks = np.maximum(1 - matrix.sum(axis=1), 0), np.minimum(losses, 0.01)
    return SampledRows(matrix, escaped, errors, free.samples, 0, leaks)
