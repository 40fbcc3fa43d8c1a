"""Factors of a row that are not yet certain: which they are, what is drawn for them, and what becomes of the others.

The first points of a patch leave few factors uncertain, mostly those of its neighbors: where two patches touch, the
factor of a point changes steeply along the patch, while that of a distant patch hardly does. Only these few are worth
more points, and a camera that wants them alone has to draw only what lies between the patch and them.

A row's sum is known better than its factors: what an error takes from one of them it gives to others. So the rest of a
row takes in proportion what the better factors leave, and the identity of the row's sum holds as it did. What that
changes of a factor counts as its error: few repetitions that agree by luck are found out by the sum.

Cost: a comparison of boxes for each uncertain factor and polygon, in blocks. Where more than `MANY` factors of a row
are uncertain everything is drawn.
"""

from __future__ import annotations

import numpy as np

from ..visibility.zbuffer import Loops

#: Error, as a share of the one wanted, from which on a factor of a row is computed anew. Each factor's own error is
#: known from few repetitions only: one that seems right by luck shall not be left as it is.
UNCERTAIN = 0.5

#: Uncertain factors of a row from which on everything is drawn.
MANY = 128

#: Share that escapes by rounding where nothing does.
NOTHING = 1e-9

#: Pairs of a factor and a polygon that may be in between, in one block.
BLOCK_PAIRS = 2**20


def uncertain(errors: np.ndarray, accuracy: float) -> np.ndarray:
    """(r, n) bool: factors to be computed anew, by the errors (r, n) of them all; whole rows above `MANY`."""
    wanted = errors > UNCERTAIN * accuracy
    return wanted | (wanted.sum(axis=1) > MANY)[:, None]


def rebalanced(
    factors: np.ndarray, first: np.ndarray, escaped: np.ndarray, anew: np.ndarray, lost: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows whose sum is again that of the first computation.

    Parameters
    ----------
    factors : (r, n) float
        Factors, some of them computed anew.
    first : (r, n) float
        All as they were computed together at first.
    escaped : (r,) float
        Shares that met no patch then.
    anew : (r, n) bool
        Which were computed anew.
    lost : float
        What escapes of each row even where nothing can.

    Returns
    -------
    factors : (r, n) float64
        Those not computed anew, and what escapes beyond `lost`, changed by one common factor in each row; none where
        the better ones leave nothing, none changed where there were none.
    escaped : (r,) float64
    """
    beyond = np.maximum(escaped - lost, 0)
    beyond[beyond < NOTHING] = 0
    others = np.where(anew, 0, factors)
    rest = others.sum(axis=1) + beyond
    missing = np.where(anew, first - factors, 0).sum(axis=1)
    growth = np.maximum(missing / np.where(rest > NOTHING, rest, np.inf), -1)
    return factors + others * growth[:, None], escaped + beyond * growth


class Between:
    """Boxes of polygons, for what may lie between two of them.

    Parameters
    ----------
    loops : Loops
        Polygons that are seen and that block.
    receivers : Loops, optional
        Polygons from which these are seen, if not the same.
    """

    def __init__(self, loops: Loops, receivers: Loops | None = None):
        self.low, self.high = _boxes(loops)
        self.receivers = (self.low, self.high) if receivers is None else _boxes(receivers)

    def __call__(self, rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """(r, n) bool: polygons that may block receivers `rows` (r,) from a patch `wanted` (r, n), and those patches.

        They meet the box around both.
        """
        low, high = self.low, self.high
        count = len(low)
        drawn = np.ones(wanted.shape, dtype=bool)
        few = np.flatnonzero(wanted.sum(axis=1) <= MANY)
        length = max(1, BLOCK_PAIRS // (MANY * count))
        for part in np.split(few, range(length, len(few), length)):
            place, other = np.nonzero(wanted[part])
            drawn[part] = False
            if not len(place):
                continue
            own_low, own_high = (bounds[rows[part][place]] for bounds in self.receivers)
            least, most = np.minimum(own_low, low[other]), np.maximum(own_high, high[other])
            meets = np.ones((len(place), count), dtype=bool)
            for axis in range(3):
                meets &= (low[:, axis] <= most[:, axis, None]) & (high[:, axis] >= least[:, axis, None])
            firsts = np.flatnonzero(np.diff(place, prepend=-1))
            drawn[part[place[firsts]]] = np.logical_or.reduceat(meets, firsts, axis=0)
        return drawn


def _boxes(loops: Loops) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corners (n, 3) of boxes around the polygons, widened by what counts as touching."""
    starts = loops.offsets[:-1]
    low, high = (extreme.reduceat(loops.corners, starts, axis=0) for extreme in (np.minimum, np.maximum))
    return low - loops.edge_on, high + loops.edge_on
