"""A square matrix with few entries in each row, made for products with a handful of columns.

Rows of about the same length lie together in slices, padded to the longest of them with entries that weigh nothing
("sliced ELLPACK": Monakov, Lokhmotov, Avetisyan 2010, "Automatically Tuning Sparse Matrix-Vector Multiplication for GPU
Architectures"). NumPy has no sparse product of its own, and sums over runs of unequal length cost it twice as much as
this: one fetch and one small matrix product per row.

Cost: 8 bytes and about 2 ns an entry for each product with up to four columns. Weights and products are float32, as
the table that rays look up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

#: Entries fetched at once: a MB of the four values each, which stays in the cache, and less work than OpenBLAS shares
#: out among threads.
SLICE = 16384

#: Columns that a product takes at once; this many are fetched fastest.
WIDTH = 4


@dataclass(frozen=True)
class Slice:
    """Some rows: their numbers (n,), and columns (n, length) int32 and weights (n, length) float32 of their entries."""

    rows: np.ndarray
    columns: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class SparseRows:
    """Matrix (size, size); rows that are in none of the slices are empty."""

    size: int
    slices: list[Slice]

    def times(self, values: np.ndarray) -> np.ndarray:
        """Product (size, c) float32 with values (size, c), c at most `WIDTH`."""
        table = np.zeros((self.size, WIDTH), np.float32)
        table[:, : values.shape[1]] = values
        out = np.zeros((self.size, WIDTH), np.float32)
        for part in self.slices:
            seen = table.take(part.columns, axis=0)
            out[part.rows] = np.matmul(part.weights[:, None, :], seen)[:, 0]
        return out[:, : values.shape[1]]

    def reweighted(self, factor: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> SparseRows:
        """The matrix with every weight multiplied by `factor` of its row numbers (n, 1) and columns (n, length)."""
        parts = []
        for part in self.slices:
            weights = part.weights * factor(part.rows[:, None], part.columns)
            parts.append(Slice(part.rows, part.columns, weights.astype(np.float32)))
        return SparseRows(self.size, parts)


def slices_of(rows: np.ndarray, columns: np.ndarray, weights: np.ndarray) -> list[Slice]:
    """Slices of entries given by row (e,), in ascending order, column (e,) and weight (e,)."""
    if not len(rows):
        return []
    starts = np.flatnonzero(np.diff(rows, prepend=rows[0] - 1))
    lengths = np.diff(starts, append=len(rows))
    order = np.argsort(lengths, kind="stable")
    parts = []
    stop = len(order)
    while stop > 0:
        # From the longest down, so that the first of a slice tells how many rows fit.
        longest = int(lengths[order[stop - 1]])
        mine = order[max(0, stop - max(1, SLICE // longest)) : stop]
        stop -= len(mine)
        place = starts[mine, None] + np.arange(longest)
        filled = np.arange(longest) < lengths[mine, None]
        np.minimum(place, len(rows) - 1, out=place)
        parts.append(
            Slice(
                rows[starts[mine]].astype(np.int32),
                np.where(filled, columns[place], 0).astype(np.int32),
                np.where(filled, weights[place], 0).astype(np.float32),
            )
        )
    return parts
