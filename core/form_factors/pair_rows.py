"""Rows of form factors from pairs of faces: each pair's unoccluded exchange, times the share of it that is visible.

What the pair-wise methods have in common. Pairs that do not face each other, and those that nothing can part, are found
by planes before anything is integrated or tested; each of the others is computed once and counts for both of its ends.
So reciprocity holds by construction. Memory: some n x n matrices, and blocks of bounded size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..environment import Environment
from ..visibility.blockable import blockable
from .faces import Faces
from .hemisphere import SampledRows
from .visible_share import Samples, visible_shares

#: Entries of the matrix worked on at once: temporaries stay below 100 MB.
BLOCK_ENTRIES = 2**18

#: Standard errors by which the sum of a row may be off where nothing escapes, and share that it may be off at most.
SUM_ERRORS = 4.0
MOST_LEAKS = 0.01

#: ``unoccluded(rows, columns, wanted)``: exchange areas (r, c) of wanted pairs, and bounds of the error of the factor
#: of the smaller face.
Unoccluded = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def pair_rows(
    environment: Environment,
    faces: Faces,
    unoccluded: Unoccluded,
    samples: Samples | None,
    accuracy: float,
    seed: int = 0,
) -> SampledRows:
    """Form factors of all patches.

    Parameters
    ----------
    environment : Environment
    faces : Faces
        Its faces.
    unoccluded : callable
        See `Unoccluded`.
    samples : Samples or None
        Tell the visible share; None sees all.
    accuracy : float
        As of `allowed_error`.
    seed : int

    Returns
    -------
    SampledRows
        `errors` are the larger one of bound and standard error; what escapes is the rest of each row.
    """
    count, areas = len(environment), environment.areas
    exchange, errors, squares = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    blocked = blockable_faces(faces) if samples is not None else None
    columns = np.arange(len(faces))
    step = max(1, BLOCK_ENTRIES // max(len(faces), 1))
    for begin in range(0, len(faces), step):
        rows, rest = columns[begin : begin + step], columns[begin:]
        values, worst = unoccluded(rows, rest, rest > rows[:, None])
        if samples is not None:
            here, there = np.nonzero((values > 0) & blocked[rows[0] : rows[-1] + 1, begin:])
            smaller = np.minimum(faces.areas[rows[here]], faces.areas[rest[there]])
            factors = values[here, there] / smaller
            shares, scatter = visible_shares(samples, rows[here], rest[there], factors, accuracy, (seed, begin))
            values[here, there] *= shares
            worst[here, there] = worst[here, there] * shares + scatter
            for ends in (faces.owners[rows[here]], faces.owners[rest[there]]):
                squares += np.bincount(ends, np.square(scatter * smaller), count)
        # Each pair was computed once; it counts for both.
        np.add.at(exchange, (faces.owners[rows][:, None], faces.owners[rest]), values)
        np.maximum.at(errors, faces.owners[rows], worst.max(axis=1))
        np.maximum.at(errors, faces.owners[rest], worst.max(axis=0))
    exchange += exchange.T
    matrix = np.minimum(exchange / np.where(areas > 0, areas, 1)[:, None], 1)
    return SampledRows(
        matrix=matrix,
        escaped=np.maximum(1 - matrix.sum(axis=1), 0),
        errors=errors,
        samples=np.ones(count, dtype=np.int64),
        rays=0 if samples is None else samples.visibility.rays,
        # What scatter takes from a row's sum, so that a closed environment is known as one.
        leaks=np.minimum(SUM_ERRORS * np.sqrt(squares) / np.where(areas > 0, areas, 1), MOST_LEAKS),
    )


def blockable_faces(faces: Faces) -> np.ndarray:
    """(f, f) bool: pairs of faces that something may stand between."""
    step = max(1, BLOCK_ENTRIES // max(len(faces), 1))
    everything = np.arange(len(faces))
    low, high, tolerance = (np.empty((len(faces), len(faces))) for _ in range(3))
    for begin in range(0, len(faces), step):
        rows = everything[begin : begin + step]
        low[rows], high[rows] = faces.height_ranges(rows, everything)
        tolerance[rows] = faces.tolerance(rows[:, None], everything)
    return blockable(low, high, tolerance)
