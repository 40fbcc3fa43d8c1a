"""Pairs of patches that whole rows leave uncertain, each computed by itself.

A method that fills a whole row at a time spends its samples on what fills the view, and knows all factors of the row to
about the same absolute error. What small, distant or touching patches exchange is not known well enough by that, for
`allowed_error` is relative to the factor. Those pairs are few, or cheap one by one, and take a second look each, at the
other patch alone.

Both ends of a pair tell its exchange, and are joined first, by their precision. The pair is judged by the factor of the
smaller patch, for which an absolute error is the harder one to keep; what is found anew counts for both ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..environment import Environment
from .allowed_error import AIM, allowed_error
from .faces import Faces, smaller_first
from .hemisphere import SampledRows
from .identities import join_estimates, precision_of

#: Pairs up to which even factors below what `allowed_error` calls small are held to their share: it costs little then.
FEW = 128

#: Variance of an exchange at least, in squares of the smaller area: a repair divides by sums of them.
LEAST_VARIANCE = 1e-24

#: ``look(first, second, guesses)``: factors (m,) of the first patch of each pair, which is the smaller one, their
#: standard errors (m,), and the number of rays.
Look = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, int]]


def with_uncertain_pairs(environment: Environment, rows: SampledRows, accuracy: float, look: Look) -> SampledRows:
    """Rows in which every pair is known as well as `accuracy` asks for.

    Parameters
    ----------
    environment : Environment
    rows : SampledRows
        With `deviations`.
    accuracy : float
        As of `allowed_error`.
    look : callable
        Computes pairs one by one: see `Look`.

    Returns
    -------
    SampledRows
        With `variances`; `errors` are those of each row's worst factor to a patch that is not smaller. What escapes
        stays as it was counted.
    """
    areas = environment.areas
    smaller = np.minimum(areas[:, None], areas)
    scale = np.where(smaller > 0, smaller, 1)
    factors = join_estimates(rows.matrix, areas, rows.samples) / scale
    deviations = np.sqrt(_joined_variances(rows, areas)) / scale
    facing = _facing(environment)
    few = facing.sum() <= 2 * FEW
    wanted = AIM * (accuracy * factors if few else allowed_error(factors, accuracy))
    first, second = np.nonzero(np.triu(facing & (deviations > wanted), 1))
    first, second = smaller_first(areas, first, second)
    matrix, cast = rows.matrix.copy(), 0
    if len(first):
        found, errors, cast = look(first, second, factors[first, second])
        matrix[first, second], matrix[second, first] = found, found * areas[first] / areas[second]
        deviations[first, second] = deviations[second, first] = errors
    smaller_ends = areas[:, None] <= areas
    return replace(
        rows,
        matrix=matrix,
        errors=deviations.max(axis=1, initial=0, where=smaller_ends & (smaller > 0)),
        rays=rows.rays + cast,
        variances=np.maximum(deviations**2, LEAST_VARIANCE) * smaller**2,
    )


def _joined_variances(rows, areas):
    """Variances (n, n) of the exchange areas of `join_estimates`."""
    precision = precision_of(areas, rows.samples)
    total = precision[:, None] + precision
    weighted = np.square((precision * areas)[:, None] * rows.deviations)
    return (weighted + weighted.T) / np.square(np.where(total > 0, total, 1))


def _facing(environment):
    """(n, n) bool: pairs of patches of which each has a part in front of the other."""
    faces = Faces(environment)
    if not len(faces):
        return np.zeros((len(environment), len(environment)), dtype=bool)
    everything = np.arange(len(faces))
    _, high = faces.height_ranges(everything, everything)
    high = high > faces.tolerance(everything[:, None], everything)
    facing = np.zeros((len(environment), len(environment)), dtype=bool)
    first, second = np.nonzero(high & high.T)
    facing[faces.owners[first], faces.owners[second]] = True
    return facing
