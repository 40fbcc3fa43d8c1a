"""What an integral over many receivers keeps book of: pairs, cells of their receivers, and what has been added up.

`clipped_quadrature` divides cells until their changes add up to less than what is allowed; here it is told which cells
may be closed, cheapest first, and what that leaves for the others. Cost: a sort of the open cells for each division.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Error per change that a division makes. On boxes with a plate or a cube between, real errors were up to 3.5 times
#: the sum of the changes, where an early division agreed by luck.
SAFETY = 4

#: Share of the tolerance that cells from which nothing is hidden may take, of which there may be many: their contour
#: integrals are nearly as cheap with many digits as with few.
EXACT_SHARE = 0.01


@dataclass(frozen=True)
class Pairs:
    """Pairs to be integrated, p of them, in the unit frame.

    Attributes
    ----------
    normals : (p, 3) float64
        Of the receivers' sides that are looked from.
    sources : (p,) int64
    tolerances : (p,) float64
    receiver_areas : (p,) float64
    looked_at : (p, k, 3) float64
        Parts of the sources before the receivers' planes.
    perimeters : (p,) float64
        Of these.
    """

    normals: np.ndarray
    sources: np.ndarray
    tolerances: np.ndarray
    receiver_areas: np.ndarray
    looked_at: np.ndarray
    perimeters: np.ndarray


@dataclass(frozen=True)
class Cells:
    """Triangles (c, 3, 3) of receivers, their pairs, parts of their receivers' areas, pieces that may shade them."""

    corners: np.ndarray
    pairs: np.ndarray
    shares: np.ndarray
    blockers: np.ndarray

    def take(self, rows: np.ndarray) -> Cells:
        """Some of the cells."""
        return Cells(self.corners[rows], self.pairs[rows], self.shares[rows], self.blockers[rows])


class Totals:
    """What has been added up of p integrals: factors, errors, what errors may still be made, and cells looked at."""

    def __init__(self, tolerances: np.ndarray):
        self.factors, self.errors = np.zeros(len(tolerances)), np.zeros(len(tolerances))
        self.budgets = tolerances * (1 - 2 * EXACT_SHARE) / SAFETY
        self.spent = np.zeros(len(tolerances))

    def add(self, pairs: np.ndarray, factors: np.ndarray, changes: np.ndarray) -> None:
        """Cells whose integral is known up to what its last division changed."""
        self.factors += np.bincount(pairs, factors, len(self.factors))
        paid = np.bincount(pairs, changes, len(self.factors))
        self.errors += SAFETY * paid
        self.budgets = np.maximum(self.budgets - paid, 0)


def affordable(task, changes, budgets):
    """(c,) bool: the cells of each task with the smallest changes, as many as its budget pays for."""
    order = np.lexsort((changes, task))
    sums = np.cumsum(np.where(np.isfinite(changes), changes, 0)[order])
    sorted_task = task[order]
    begins = np.searchsorted(sorted_task, sorted_task)
    before = np.where(begins > 0, sums[begins - 1], 0.0)
    result = np.empty(len(task), dtype=bool)
    # Sums over all tasks before it round: an exact 0 stays affordable whatever they are.
    result[order] = (sums - before <= budgets[sorted_task]) | (changes[order] == 0)
    return result & np.isfinite(changes)
