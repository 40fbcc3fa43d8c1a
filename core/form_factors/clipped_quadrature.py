"""Adaptive quadrature of exactly clipped polygons: form factors with occlusion, without a single random number.

At a point, the visible parts of the other polygon are found exactly (`visible_fragments`) and each has its factor in
closed form. What is left is one smooth integral over the receiver, with kinks where shadows begin: cells of it are cut
along `critical_lines` or divided until what a division changes adds up to less than the accuracy. So occlusion costs no
noise: errors of 1e-6 take as little as a second on a pair, where rays would need 1e9.

Choose it (``visibility="bsp"``) for pairs, points and small environments; a point's result is exact to rounding. For n
patches it costs n^2 integrals, each proportional to the blockers between: some 10 ms a pair at an accuracy of 1e-4.

Where all points of a cell see alike, all or nothing, a division changes nothing, and an agreement of 0 with 0 proves
nothing either. So the part of a receiver behind the source's plane is cut off first, planes of blockers are cut along
before any change counts, and places near a cell's corners must see what its points see.

Limits: shadows of a blocker much smaller than the accuracy's share of the receiver may fall between sample points.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..visibility.bsp import TOLERANCE, BspTree
from ..visibility.convex_loops import join, pad, split
from ..visibility.shafts import shaft_candidates
from ..visibility.visible_fragments import FragmentClipper, fragment_factors
from .critical_lines import ON_LINE, CriticalLines, critical_lines
from .hemisphere import SampledRows

#: Views evaluated at once: temporaries near 50 MB.
BLOCK_VIEWS = 8192

#: Cells of one pair after which division stops; the error it stops with is returned.
MOST_CELLS = 100_000

#: A cell that a blocker may shade is divided until it is at most this many times as long as the smallest such blocker:
#: a shadow is at least about as large as what casts it, and must not fall between the points of a cell.
CELL_TO_BLOCKER = 2.0

#: Share of a receiver that a cell may have when a blocker may shade it, unless what it contributes is below this many
#: times the accuracy. With fewer cells, two divisions may agree by luck: on a plate in a box they did, to a tenth of
#: the real error; changes of many cells add up whatever their signs.
LARGEST_SHADED = 1 / 12
NEGLIGIBLE = 8

#: Error per change that a division makes. On boxes with a plate or a cube between, real errors were up to 3.5 times
#: the sum of the changes, where an early division agreed by luck.
SAFETY = 4

#: Part of a cell that a cut may leave in one piece while the change it makes counts as an estimate of the error.
LARGEST_PART = 0.9

_A, _B = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21

#: Radon's rule of degree 5 on the triangle: barycentric coordinates (7, 3) and weights (7,).
RULE_POINTS = np.array(
    [[1 / 3] * 3]
    + [[1 - 2 * a if place == corner else a for place in range(3)] for a in (_A, _B) for corner in range(3)]
)
RULE_WEIGHTS = np.array([9 / 40] + [(155 - 15**0.5) / 1200] * 3 + [(155 + 15**0.5) / 1200] * 3)

#: Places near the corners of a cell, where a border that misses all points of the rule crosses it.
PROBES = np.full((3, 3), 0.01) + 0.97 * np.eye(3)

#: Whether the points of a cell see some of the source's parts, nothing, or all; and the difference that counts as none.
MIXED, HIDDEN, LIT = 0, 1, 2
SAME = 1e-9

logger = logging.getLogger(__name__)


class ClippedQuadrature:
    """Integrals between the patches of an environment, all of whose polygons block.

    Parameters
    ----------
    environment : Environment
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self.tree = BspTree.build(environment)
        self.clipper = FragmentClipper(self.tree, environment.two_sided)
        pieces = self.tree.pieces
        self.order = np.argsort(pieces.patches, kind="stable")
        self.counts = np.bincount(pieces.patches, minlength=len(environment))
        self.starts = np.cumsum(self.counts) - self.counts
        self.hulls = pieces.to_unit(pad(environment.polygons))
        self.extents = np.ptp(pieces.loops, axis=1).max(axis=1)
        self.views = 0

    def point(self, point: np.ndarray, normal: np.ndarray, source: int) -> float:
        """Exact configuration factor from a differential area to a patch."""
        place = self.tree.pieces.to_unit(point)[None]
        everything = np.arange(len(self.tree.nodes))[None]
        blockers = shaft_candidates(self.tree, place[:, None], self.hulls[[source]], everything)
        return float(self._factors(place, normal[None], np.array([source]), blockers)[0])

    def pairs(self, receivers: np.ndarray, sources: np.ndarray, tolerances: np.ndarray):
        """Form factors (p,) from patches to others, and their errors (p,).

        Parameters
        ----------
        receivers, sources : (p,) int
        tolerances : (p,) float
            Error wanted of each factor.
        """
        receivers, sources = np.asarray(receivers), np.asarray(sources)
        factors, errors = np.zeros(len(receivers)), np.zeros(len(receivers))
        two_sided = self.environment.two_sided[receivers]
        for side in (1.0, -1.0):
            chosen = np.flatnonzero(self._facing(receivers, sources, side) & ((side > 0) | two_sided))
            if not len(chosen):
                continue
            # A two-sided patch gives half of its power to either side.
            weights = np.where(two_sided[chosen], 0.5, 1.0)
            limits = np.broadcast_to(tolerances, factors.shape)[chosen]
            values, changes = self._integrate(receivers[chosen], sources[chosen], side, limits)
            factors[chosen] += weights * values
            errors[chosen] += weights * changes
        return factors.clip(0, 1), errors

    def _facing(self, receivers, sources, side):
        """(p,) bool: whether something of each patch lies before the other, on the receiver's given side."""
        normals = self.environment.normals
        first, second = self.hulls[receivers], self.hulls[sources]
        over = np.einsum("pki,pi->pk", second - first[:, :1], normals[receivers]) * side
        back = np.einsum("pki,pi->pk", first - second[:, :1], normals[sources])
        seen = (back > TOLERANCE).any(axis=1)
        seen |= self.environment.two_sided[sources] & (back < -TOLERANCE).any(axis=1)
        areas = self.environment.areas
        return seen & (over > TOLERANCE).any(axis=1) & (areas[receivers] > 0) & (areas[sources] > 0)

    def _integrate(self, receivers, sources, side, tolerances):
        environment, tree = self.environment, self.tree
        triangles = tree.pieces.to_unit(environment.vertices[environment.triangles])
        counts = np.bincount(environment.triangle_patches, minlength=len(environment))
        starts = np.cumsum(counts) - counts
        task = np.repeat(np.arange(len(receivers)), counts[receivers])
        rows = _ranges(starts[receivers], counts[receivers])
        cells = triangles[rows]
        totals = np.bincount(task, _areas(cells), len(receivers))
        cells, task = self._lit(cells, task, sources)
        shares = _areas(cells) / totals[task]
        everything = np.broadcast_to(np.arange(len(tree.nodes)), (len(receivers), len(tree.nodes)))
        between = shaft_candidates(tree, self.hulls[receivers], self.hulls[sources], everything)
        normals = side * environment.normals[receivers]
        blockers = shaft_candidates(tree, cells, self.hulls[sources[task]], between[task])
        values = self._cell_means(cells, normals[task], sources[task], blockers)[0] * shares
        offsets = np.einsum("pi,pi->p", normals, self.hulls[receivers, 0])
        lines = critical_lines((normals, offsets), self.hulls[sources], tree.pieces.loops[between], between >= 0)
        factors, errors, budgets = np.zeros(len(receivers)), np.zeros(len(receivers)), tolerances / SAFETY
        spent = np.zeros(len(receivers))
        while len(cells):
            spent += np.bincount(task, minlength=len(receivers))
            children, parents, parts, strongly = _divide(cells, task, lines)
            inherited = shaft_candidates(tree, children, self.hulls[sources[task[parents]]], blockers[parents])
            limits = tolerances[task[parents]]
            views = normals[task[parents]], sources[task[parents]], inherited
            finer, most, alike = self._cell_means(children, *views)
            finer *= parts * shares[parents]
            most *= parts * shares[parents]
            sums = np.bincount(parents, finer, len(cells))
            changes = np.abs(sums - values)
            coarse = np.zeros(len(cells), dtype=bool)
            unknown = self._coarse(children, inherited, most, shares[parents] * parts, limits)
            unknown |= (parts > LARGEST_PART) | (strongly[parents] & (most > limits))
            suspects = np.flatnonzero(~unknown & (alike != MIXED) & (inherited >= 0).any(axis=1) & (most > limits))
            views = [array[suspects] for array in views]
            unknown[suspects] = self._cell_means(children[suspects], *views, PROBES)[2] != alike[suspects]
            np.logical_or.at(coarse, parents, unknown)
            done = _affordable(task, np.where(coarse, np.inf, changes), budgets / 2) | (spent > MOST_CELLS)[task]
            factors += np.bincount(task[done], sums[done], len(receivers))
            paid = np.bincount(task[done], changes[done], len(receivers))
            errors, budgets = errors + paid, np.maximum(budgets - paid, 0)
            rest = ~done[parents]
            cells, values, blockers = children[rest], finer[rest], inherited[rest]
            shares, task = (parts * shares[parents])[rest], task[parents[rest]]
        return factors, errors * SAFETY

    def _lit(self, cells, task, sources):
        """Parts of the cells from which a side of their source that radiates is seen, and their tasks.

        Without this cut a tip that alone sees the source could lie between all points, and 0 agree with 0.
        """
        environment = self.environment
        normals = environment.normals[sources]
        offsets = np.einsum("pi,pi->p", normals, self.hulls[sources, 0])
        heights = np.einsum("cki,ci->ck", cells, normals[task]) - offsets[task][:, None]
        front, front_rows, back, back_rows = split(cells, heights, TOLERANCE)
        both = environment.two_sided[sources[task[back_rows]]]
        loops, rows = join([front, back[both]]), np.concatenate((front_rows, back_rows[both]))
        triangles, parents = _fans(loops)
        return triangles, task[rows[parents]]

    def _coarse(self, cells, blockers, most, shares, tolerances):
        """(c,) bool: cells whose points may have missed a blocker, or a way past it, that matters.

        `most` is what the cells would contribute without blockers.
        """
        if not blockers.shape[1]:
            return np.zeros(len(cells), dtype=bool)
        smallest = np.where(blockers >= 0, self.extents[blockers], np.inf).min(axis=1)
        long = np.ptp(cells, axis=1).max(axis=1) > CELL_TO_BLOCKER * smallest
        shaded = (blockers >= 0).any(axis=1)
        return (long & (most > tolerances)) | (shaded & (shares > LARGEST_SHADED) & (most > tolerances * NEGLIGIBLE))

    def _cell_means(self, cells, normals, sources, blockers, rule=RULE_POINTS):
        """Mean factors (c,) over triangles (c, 3, 3) to their sources, the same without blockers, and what is alike.

        The last says whether all points of the rule see all that is before them, or nothing, or neither.
        """
        means, most, alike = np.empty(len(cells)), np.empty(len(cells)), np.empty(len(cells), dtype=np.int8)
        weights = RULE_WEIGHTS if rule is RULE_POINTS else np.full(len(rule), 1 / len(rule))
        block = max(1, BLOCK_VIEWS // len(rule))
        for start in range(0, len(cells), block):
            rows = slice(start, start + block)
            points = np.einsum("qb,cbi->cqi", rule, cells[rows]).reshape(-1, 3)
            repeated = [np.repeat(a[rows], len(rule), axis=0) for a in (normals, sources, blockers)]
            seen = self._factors(points, *repeated)
            whole, (facing, looked_at, between) = seen.copy(), repeated
            shaded = np.flatnonzero((between >= 0).any(axis=1))
            whole[shaded] = self._factors(points[shaded], facing[shaded], looked_at[shaded], between[shaded, :0])
            seen, whole = seen.reshape(-1, len(rule)), whole.reshape(-1, len(rule))
            means[rows], most[rows] = seen @ weights, whole @ weights
            hidden, lit = (seen == 0).all(axis=1), (seen >= whole * (1 - SAME)).all(axis=1)
            alike[rows] = np.where(lit, LIT, np.where(hidden, HIDDEN, MIXED))
        return means, most, alike

    def _factors(self, points, normals, sources, blockers):
        """Exact factors (v,) from points of the unit frame to one source each."""
        self.views += len(points)
        counts = self.counts[sources]
        owners = np.repeat(np.arange(len(points)), counts)
        targets = self.order[_ranges(self.starts[sources], counts)]
        fragments = self.clipper.visible(points[owners], normals[owners], targets, blockers[owners])
        parts = fragment_factors(fragments, normals[owners])
        return np.bincount(owners[fragments.views], parts, len(points)).clip(0, 1)


def clipped_rows(environment, visibility, accuracy, seed=0, threads=0) -> SampledRows:
    """Form factors of all patches by exact clipping; the error of each is below `accuracy`.

    `visibility` is ``bsp``. Nothing is random and no thread is used: `seed` and `threads` change nothing. The result is
    that of `hemisphere_rows`; what escapes is the rest of each row.
    """
    count = len(environment)
    quadrature = ClippedQuadrature(environment)
    first, second = np.triu_indices(count, 1)
    areas = environment.areas
    # Points go to the smaller patch, whose factor is the larger one: reciprocity carries it over, with less error.
    swap = areas[first] > areas[second]
    receivers, sources = np.where(swap, second, first), np.where(swap, first, second)
    values, changes = quadrature.pairs(receivers, sources, np.full(len(receivers), accuracy))
    matrix, errors = np.zeros((count, count)), np.zeros(count)
    matrix[receivers, sources] = values
    matrix[sources, receivers] = values * areas[receivers] / np.where(areas[sources] > 0, areas[sources], 1)
    np.maximum.at(errors, receivers, changes)
    np.maximum.at(errors, sources, changes)
    # What a row's factors together may be off, so that a closed environment is known as one.
    losses = np.bincount(receivers, changes, count) + np.bincount(sources, changes, count)
    if errors.max(initial=0) > accuracy:
        logger.warning("Form factors are accurate to %.2g only, not %.2g: cell limit", errors.max(), accuracy)
    escaped = np.maximum(1 - matrix.sum(axis=1), 0)
    return SampledRows(
        matrix, escaped, errors, np.ones(count, dtype=np.int64), quadrature.views, np.minimum(losses, 0.01)
    )


def _affordable(task, changes, budgets):
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


def _ranges(starts, counts):
    """Numbers from each start on, as many as its count, one after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - (ends - counts), counts)


def _divide(cells: np.ndarray, pairs: np.ndarray, lines: CriticalLines):
    """Smaller triangles in place of each cell, which of the cells each belongs to, and its part of that cell's area.

    Cells that a critical line crosses are cut along it, others in four.
    """
    best, heights = lines.best(cells, pairs)
    whole, crossed = np.flatnonzero(best < 0), np.flatnonzero(best >= 0)
    children, parents = [_quarter(cells[whole])], [np.repeat(whole, 4)]
    above, above_rows, below, below_rows = split(cells[crossed], heights[crossed], ON_LINE)
    for loops, rows in ((above, above_rows), (below, below_rows)):
        triangles, places = _fans(loops)
        children.append(triangles)
        parents.append(crossed[rows[places]])
    children, parents = np.concatenate(children), np.concatenate(parents)
    areas = _areas(children)
    strongly = np.zeros(len(cells), dtype=bool)
    strongly[crossed] = lines.strong[pairs[crossed], best[crossed]]
    return children, parents, areas / np.bincount(parents, areas, len(cells))[parents], strongly


def _fans(loops):
    """Triangles with an area that fill convex loops, and the loop of each."""
    fans = [loops[:, [0, corner, corner + 1]] for corner in range(1, loops.shape[1] - 1)]
    triangles, owners = np.concatenate(fans), np.tile(np.arange(len(loops)), len(fans))
    real = _areas(triangles) > 0
    return triangles[real], owners[real]


def _areas(triangles):
    """Areas (t,), doubled."""
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)


def _quarter(cells):
    """(4 c, 3, 3) triangles, the four of each one after the other."""
    middles = (cells + np.roll(cells, -1, axis=1)) / 2
    a, b, c = cells.transpose(1, 0, 2)
    ab, bc, ca = middles.transpose(1, 0, 2)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
