"""Form factors between patches from rays that count in both directions.

A ray from patch i that meets patch j tells of the light that goes from j to i, and as much of that from i to j: the
power exchanged by unit radiosities, A_i F_ij = A_j F_ji, is the same. Patches that took light by their own rays alone
would each have an estimate of its own, and light would be lost or won at every reflection: between a bright plate and
the lid a few millimeters above it that error is multiplied many times. Here both estimates are joined by the balance
heuristic (Veach and Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", eq. 9): where
patch i sends d_i rays per unit of its open area, every ray between i and j carries 1 / (d_i + d_j), whichever of them
sent it. The matrix is symmetric, and a small patch that big ones miss is heard through its own rays.

What is symmetric no longer sums to one, and a furnace must stay even. A symmetric scaling, D X D, would mend the sums
and keep the symmetry (Sinkhorn 1967, "Diagonal Equivalence to Matrices with Prescribed Row and Column Sums"). Run to
its end it is not safe: where rays are few, in a pocket of some millimeters, it blows up single entries, by which light
was measured to be 14 % more wrong there. So it takes `SWEEPS` damped sweeps with factors of at most `MOST`, and in the
end each row is stretched to the sum that its own rays have found. A row's sum is exact then, and what is left of
asymmetry between i and j is the quotient of their last stretches.

Light of the sky and of lamps is no exchange between patches and is not touched. Patches inside solids exchange nothing
with what is outside: rays to and from them count one way.

Cost: one sort of the pairs that rays join, at most twice as many as rays; a product per sweep of the scaling.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .sparse_rows import Slice, SparseRows, slices_of

#: Sweeps of the scaling: the first takes most of the error of the sums.
SWEEPS = 3

#: Bound of a patch's factor, and of its inverse.
MOST = 4.0

#: Entries put in order at a time, and rays counted at a time: some tens of MB.
BLOCK = 1 << 21

#: Bits for the number of rays of one pair, beside those of two rows.
COUNT_BITS = 20


@dataclass(frozen=True)
class SeenRows:
    """What patches have met: table rows (n * k, N) from k points of each of the patches `rows` (n,), and which of the
    points are `kept` (n, k); those that are not count for nothing."""

    rows: np.ndarray
    seen: np.ndarray
    kept: np.ndarray

    @property
    def rays(self) -> np.ndarray:
        """(n,) rays of each patch that count."""
        return self.kept.sum(axis=1) * self.seen.shape[1]


def two_way_factors(batches: Iterable[SeenRows], areas: np.ndarray, is_open: np.ndarray) -> SparseRows:
    """Form factors F (m, m) between m patches, fronts and backs, such that irradiance is F times radiosity.

    Parameters
    ----------
    batches : iterable of SeenRows
        Each patch in one of them at most. Rows of the table from m on are no patches.
    areas : (m,) float
        Of patches as a whole, in any unit; the part counts whose points are kept.
    is_open : (m,) bool
        Patches whose rays count both ways among each other. All others keep to what their own rays have met, and so
        does whoever meets them.

    Returns
    -------
    SparseRows
        Row i sums to the share of its counted rays that meet patches.
    """
    batches = list(batches)
    size = len(areas)
    rays, surface = np.zeros(size), np.zeros(size)
    for batch in batches:
        rays[batch.rows] = batch.rays
        surface[batch.rows] = areas[batch.rows] * batch.kept.mean(axis=1)
    # Who sent no rays could not answer in kind.
    is_open = is_open & (rays > 0) & (surface > 0)
    pairs = _Pairs.of(batches, size)
    density = rays / np.where(is_open, surface, 1)
    mutual = is_open[pairs.origins] & is_open[pairs.targets]
    wanted = np.bincount(pairs.origins, weights=pairs.counts * mutual, minlength=size) / np.where(is_open, density, 1)
    exchange = SparseRows(size, pairs.slices(is_open, density, rays))
    scale, stretch = _scaling(exchange, wanted, is_open)
    stretch = stretch / np.where(is_open, surface, 1)
    return exchange.reweighted(
        lambda row, column: np.where(is_open[row] & is_open[column], stretch[row] * scale[column], 1)
    )


def _scaling(exchange: SparseRows, wanted: np.ndarray, is_open: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of the columns (m,), and then those of the rows (m,) that make the sums `wanted` (m,)."""
    scale = is_open.astype(float)
    for _ in range(SWEEPS):
        # The root is the damping: a full step would be undone by the same step of the other side.
        found = scale * exchange.times(scale[:, None])[:, 0]
        some = (found > 0) & (wanted > 0)
        scale[some] = np.clip(scale[some] * np.sqrt(wanted[some] / found[some]), 1 / MOST, MOST)
    found = exchange.times(scale[:, None])[:, 0].astype(float)
    return scale, np.where(found > 0, wanted / np.where(found > 0, found, 1), 0)


@dataclass(frozen=True)
class _Pairs:
    """Pairs of patches (e,) int32 each, `origins` and `targets`, with the `counts` of rays that go so."""

    origins: np.ndarray
    targets: np.ndarray
    counts: np.ndarray

    @classmethod
    def of(cls, batches: list[SeenRows], size: int) -> _Pairs:
        parts = [np.empty((3, 0), np.int32)]
        for batch in batches:
            each = batch.seen.shape[1] * batch.kept.shape[1]
            step = max(1, BLOCK // max(each, 1))
            for start in range(0, len(batch.rows), step):
                parts.append(_counted(batch, slice(start, start + step), size))
        return cls(*np.concatenate(parts, axis=1))

    def slices(self, is_open: np.ndarray, density: np.ndarray, rays: np.ndarray) -> list[Slice]:
        """Power that open patches exchange, by unit radiosities; elsewhere the share of the origin's rays."""
        size = len(is_open)
        mutual = is_open[self.origins] & is_open[self.targets]
        entries = np.bincount(self.origins, minlength=size) + np.bincount(self.targets[mutual], minlength=size)
        upto = np.cumsum(entries)
        bounds = np.unique(np.searchsorted(upto, np.arange(0, upto[-1], BLOCK)))
        parts = []
        for low, high in pairwise([*bounds, size]):
            # All rays that leave these rows, and those that open ones send back.
            leaving = (self.origins >= low) & (self.origins < high)
            coming = mutual & (self.targets >= low) & (self.targets < high)
            row = np.concatenate([self.origins[leaving], self.targets[coming]])
            column = np.concatenate([self.targets[leaving], self.origins[coming]])
            row, column, counts = _merged(
                row, column, np.concatenate([self.counts[leaving], self.counts[coming]]), size
            )
            both = is_open[row] & is_open[column]
            weights = counts / np.where(both, density[row] + density[column], rays[row])
            parts += slices_of(row, column, weights)
        return parts


def _counted(batch: SeenRows, part: slice, size: int) -> np.ndarray:
    """Origins, targets and counts (3, e) int32 of the rays of some of the batch's patches."""
    each = batch.kept.shape[1]
    kept = batch.kept[part]
    seen = batch.seen[part.start * each : part.stop * each]
    targets = np.where(kept.reshape(-1, 1), np.minimum(seen, size), size).reshape(len(kept), -1)
    targets.sort(axis=1)
    first = np.ones(targets.shape, bool)
    np.not_equal(targets[:, 1:], targets[:, :-1], out=first[:, 1:])
    first = np.flatnonzero(first)
    counts = np.diff(first, append=targets.size)
    found = np.stack([batch.rows[part][first // targets.shape[1]], targets.ravel()[first], counts])
    return found[:, found[1] < size].astype(np.int32)


def _merged(row, column, counts, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries (e,) in order, those of the same row and column as one with the sum of their counts."""
    # One integer each: sorting these is far cheaper than an order of three arrays.
    if size > 1 << (63 - COUNT_BITS) // 2:
        raise ValueError(f"{size:,} patches are more than can be paired")
    packed = row.astype(np.int64) * size + column
    packed <<= COUNT_BITS
    packed += counts
    packed.sort()
    pair = packed >> COUNT_BITS
    first = np.flatnonzero(np.diff(pair, prepend=-1))
    packed &= (1 << COUNT_BITS) - 1
    counts = np.add.reduceat(packed, first) if len(first) else packed
    return *np.divmod(pair[first], size), counts
