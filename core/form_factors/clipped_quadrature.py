"""Adaptive quadrature of exactly clipped polygons: form factors with occlusion, without a single random number.

At a point, the visible parts of the other polygon are found exactly (`visible_fragments`) and each has its factor in
closed form. What is left is one smooth integral over the receiver, with kinks where shadows begin: cells of it are cut
along `critical_lines` or divided until what a division changes adds up to less than the accuracy. So occlusion costs no
noise: errors of 1e-6 take as little as a second on a pair, where rays would need 1e9. Cells from which no blocker is
met, and pairs of patches that none can part, take the contour integral and are exact.

Choose it (``visibility="bsp"``) for pairs, points and small environments; a point's result is exact to rounding. For n
patches it costs n^2 integrals, each proportional to the blockers between: some 4 ms a pair at an accuracy of 1e-4.

Where all points of a cell see alike, all or nothing, a division changes nothing, and an agreement of 0 with 0 proves
nothing either. So the part of a receiver behind the source's plane is cut off first, planes of blockers are cut along
before any change counts, and places near a cell's corners must see what its points see. Changes may cancel, so a cell's
roughness counts, too. Memory stays near 200 MB whatever the number of pairs: they are worked on some at a time.

Limits: shadows of a blocker much smaller than the accuracy's share of the receiver may fall between sample points.
"""

from __future__ import annotations

import logging

import numpy as np

from ..environment import Environment
from ..visibility.bsp import TOLERANCE, BspTree
from ..visibility.convex_loops import join, pad, split
from ..visibility.outlines import Outlines
from ..visibility.shafts import shaft_candidates
from ..visibility.visible_fragments import FragmentClipper, fragment_factors
from ..visibility.zbuffer import ranges
from .clipped_cells import EXACT_SHARE, Cells, Pairs, Totals, affordable
from .contour_integral import ROUNDING, contour_sums
from .critical_lines import critical_lines
from .faces import smaller_first
from .hemisphere import SampledRows
from .plane_clipping import clip_loops
from .triangle_cells import NULL_WEIGHTS, RULE_POINTS, RULE_WEIGHTS, areas, divide, fans

#: Views evaluated at once: temporaries near 25 MB.
BLOCK_VIEWS = 4096

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

#: What a cell's values deviate from a parabola counts, by this share, as a change at least: it does not cancel, as the
#: changes of several cells may. With it no factor of four reference enclosures, in either direction, errs by more than
#: 0.6 of what is asked for (1e-3, 1e-4, 1e-5), where some had erred by twice that.
ROUGHNESS = 0.3

#: Share of the tolerance below which a cell is not looked at again though its points may have missed something: each
#: pair that is shaded states an error of at least that much.
RISK = 0.1

#: Part of a cell that a cut may leave in one piece while the change it makes counts as an estimate of the error.
LARGEST_PART = 0.9

#: Cells pending above which the pairs that they belong to are worked on one half after the other: about 100 MB.
MOST_ACTIVE = 2**15

#: Pairs times pieces of the tree that are worked on together: about 100 MB with what is found between them.
MOST_CANDIDATES = 2**18

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
        self.outlines = Outlines.build(environment, self.tree.pieces)
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
        return float(self._factors(place, normal[None], np.array([source]), blockers)[0][0])

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
            seen = np.flatnonzero(self._facing(receivers, sources, side) & ((side > 0) | two_sided))
            step = max(1, MOST_CANDIDATES // len(self.tree.nodes)) if len(seen) else 1
            for start in range(0, len(seen), step):
                chosen = seen[start : start + step]
                # A two-sided patch gives half of its power to either side.
                weights = np.where(two_sided[chosen], 0.5, 1.0)
                limits = np.broadcast_to(tolerances, factors.shape)[chosen]
                values, changes = self._side(receivers[chosen], sources[chosen], side, limits)
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

    def _side(self, receivers, sources, side, tolerances):
        """Factors and errors (p,) of one side of the receivers."""
        totals = Totals(tolerances)
        pairs, cells, lines = self._begin(receivers, sources, side, tolerances)
        free = self._is_free(cells, pairs)
        exact = [cells.take(free)]
        cells = cells.take(~free)
        values = self._means(cells, pairs)[0] * cells.shares
        self._refine(pairs, cells, values, lines, totals, exact)
        for part in exact:
            self._add_exact(part, pairs, totals)
        return totals.factors, np.maximum(totals.errors, np.where(totals.spent > 0, RISK * tolerances, 0))

    def _begin(self, receivers, sources, side, tolerances):
        """The pairs, the cells that their integrals begin with, and their critical lines."""
        environment, tree = self.environment, self.tree
        normals, hulls, others = side * environment.normals[receivers], self.hulls[receivers], self.hulls[sources]
        looked_at = clip_loops(others, _heights(others, normals, hulls))
        behind = _heights(hulls, environment.normals[sources], others)
        lit = clip_loops(hulls, np.where(environment.two_sided[sources][:, None], 1.0, behind))
        everything = np.broadcast_to(np.arange(len(tree.nodes)), (len(receivers), len(tree.nodes)))
        between = shaft_candidates(tree, lit, looked_at, everything)
        patches = np.where(between >= 0, tree.pieces.patches[between], -1)
        lines = critical_lines(self.outlines, normals, lit, looked_at, sources, patches)
        triangles = tree.pieces.to_unit(environment.vertices[environment.triangles])
        counts = np.bincount(environment.triangle_patches, minlength=len(environment))
        task, rows = ranges((np.cumsum(counts) - counts)[receivers], counts[receivers])
        totals = np.bincount(task, areas(triangles[rows]), len(receivers))
        corners, task = self._lit(triangles[rows], task, sources)
        perimeters = np.linalg.norm(np.roll(looked_at, -1, axis=1) - looked_at, axis=2).sum(axis=1)
        pairs = Pairs(normals, sources, tolerances, totals, looked_at, perimeters)
        blockers = shaft_candidates(tree, corners, looked_at[task], between[task])
        return pairs, Cells(corners, task, areas(corners) / totals[task], blockers), lines

    def _is_free(self, cells, pairs):
        """(c,) bool: cells from which nothing can block the source, and whose contour integral has the digits."""
        edges = np.linalg.norm(np.roll(cells.corners, -1, axis=1) - cells.corners, axis=2).sum(axis=1)
        rounding = ROUNDING * edges * pairs.perimeters[cells.pairs] / (2 * np.pi * pairs.receiver_areas[cells.pairs])
        digits = rounding <= EXACT_SHARE * pairs.tolerances[cells.pairs] * cells.shares
        return digits & (cells.blockers < 0).all(axis=1)

    def _add_exact(self, cells, pairs, totals):
        """Add cells from which nothing is hidden, by contour integrals."""
        for start in range(0, len(cells.pairs), BLOCK_VIEWS):
            part = cells.pairs[start : start + BLOCK_VIEWS]
            corners, shares = cells.corners[start : start + BLOCK_VIEWS], cells.shares[start : start + BLOCK_VIEWS]
            origin = corners[:, :1]
            allowed = EXACT_SHARE * pairs.tolerances[part] * shares
            sums, _ = contour_sums(
                corners - origin, pairs.looked_at[part] - origin, allowed * pairs.receiver_areas[part]
            )
            # The sign tells the sides that are turned to each other, which are known.
            totals.add(part, np.abs(sums) / pairs.receiver_areas[part], np.zeros(len(part)))
            totals.errors += np.bincount(part, 2 * allowed, len(totals.errors))

    def _refine(self, pairs, cells, values, lines, totals, exact):
        """Divide cells until what that changes is below the tolerances, and add them up; free ones go to `exact`."""
        while len(cells.pairs):
            many = len(np.unique(cells.pairs))
            if len(cells.pairs) > MOST_ACTIVE and many > 1:
                # One half after the other: what is pending stays bounded, however many pairs there are.
                early = cells.pairs <= np.partition(np.unique(cells.pairs), many // 2 - 1)[many // 2 - 1]
                for half in (early, ~early):
                    self._refine(pairs, cells.take(half), values[half], lines, totals, exact)
                return
            totals.spent += np.bincount(cells.pairs, minlength=len(totals.spent))
            corners, parents, parts, strongly = divide(cells.corners, cells.pairs, lines)
            owners = cells.pairs[parents]
            blockers = shaft_candidates(self.tree, corners, pairs.looked_at[owners], cells.blockers[parents])
            children = Cells(corners, owners, parts * cells.shares[parents], blockers)
            finer, most, alike, rough = self._means(children, pairs)
            rough = np.bincount(parents, rough * children.shares, len(cells.pairs))
            finer, most = finer * children.shares, most * children.shares
            sums = np.bincount(parents, finer, len(cells.pairs))
            changes = np.maximum(np.abs(sums - values), ROUGHNESS * rough)
            unsure = (parts > LARGEST_PART) | (strongly[parents] & (most > pairs.tolerances[owners]))
            unsure |= self._coarse(children, pairs, most)
            unsure |= self._missed(children, pairs, most, alike, ~unsure)
            coarse = np.zeros(len(cells.pairs), dtype=bool)
            np.logical_or.at(coarse, parents, unsure)
            done = affordable(cells.pairs, np.where(coarse, np.inf, changes), totals.budgets / 2)
            done |= (totals.spent > MOST_CELLS)[cells.pairs]
            totals.add(cells.pairs[done], sums[done], changes[done])
            rest = np.flatnonzero(~done[parents])
            free = self._is_free(children.take(rest), pairs)
            exact.append(children.take(rest[free]))
            cells, values = children.take(rest[~free]), finer[rest[~free]]

    def _lit(self, cells, task, sources):
        """Parts of the cells from which a side of their source that radiates is seen, and their tasks.

        Without this cut a tip that alone sees the source could lie between all points, and 0 agree with 0.
        """
        heights = _heights(cells, self.environment.normals[sources][task], self.hulls[sources][task])
        front, front_rows, back, back_rows = split(cells, heights, TOLERANCE)
        both = self.environment.two_sided[sources[task[back_rows]]]
        loops, rows = join([front, back[both]]), np.concatenate((front_rows, back_rows[both]))
        triangles, parents = fans(loops)
        return triangles, task[rows[parents]]

    def _coarse(self, cells, pairs, most):
        """(c,) bool: cells whose points may have missed a blocker, or a way past it, that matters.

        `most` is what the cells would contribute without blockers.
        """
        if not cells.blockers.shape[1]:
            return np.zeros(len(cells.pairs), dtype=bool)
        tolerances = pairs.tolerances[cells.pairs]
        smallest = np.where(cells.blockers >= 0, self.extents[cells.blockers], np.inf).min(axis=1)
        long = np.ptp(cells.corners, axis=1).max(axis=1) > CELL_TO_BLOCKER * smallest
        shaded = (cells.blockers >= 0).any(axis=1)
        return (long & (most > RISK * tolerances)) | (
            shaded & (cells.shares > LARGEST_SHADED) & (most > tolerances * NEGLIGIBLE)
        )

    def _missed(self, cells, pairs, most, alike, asked):
        """(c,) bool: cells, of those asked about, near whose corners the source looks other than from their points."""
        asked = (
            asked & (alike != MIXED) & (cells.blockers >= 0).any(axis=1) & (most > RISK * pairs.tolerances[cells.pairs])
        )
        suspects = np.flatnonzero(asked)
        missed = np.zeros(len(cells.pairs), dtype=bool)
        missed[suspects] = self._means(cells.take(suspects), pairs, PROBES)[2] != alike[suspects]
        return missed

    def _means(self, cells, pairs, rule=RULE_POINTS):
        """Mean factors (c,) over cells to their sources, the same without blockers, what is alike, and the roughness.

        The third says whether all points of the rule see all that is before them, or nothing, or neither.
        """
        count = len(cells.pairs)
        means, most, rough = np.empty(count), np.empty(count), np.zeros(count)
        alike = np.empty(count, dtype=np.int8)
        weights = RULE_WEIGHTS if rule is RULE_POINTS else np.full(len(rule), 1 / len(rule))
        block = max(1, BLOCK_VIEWS // len(rule))
        for start in range(0, count, block):
            rows = slice(start, start + block)
            points = np.einsum("qb,cbi->cqi", rule, cells.corners[rows]).reshape(-1, 3)
            task, blockers = (np.repeat(a[rows], len(rule), axis=0) for a in (cells.pairs, cells.blockers))
            seen, whole = self._factors(points, pairs.normals[task], pairs.sources[task], blockers)
            seen, whole = seen.reshape(-1, len(rule)), whole.reshape(-1, len(rule))
            means[rows], most[rows] = seen @ weights, whole @ weights
            if rule is RULE_POINTS:
                rough[rows] = np.abs(seen @ NULL_WEIGHTS)
            hidden, lit = (seen == 0).all(axis=1), (seen >= whole * (1 - SAME)).all(axis=1)
            alike[rows] = np.where(lit, LIT, np.where(hidden, HIDDEN, MIXED))
        return means, most, alike, rough

    def _factors(self, points, normals, sources, blockers):
        """Exact factors (v,) from points of the unit frame to one source each, and what they are without blockers."""
        self.views += len(points)
        counts = self.counts[sources]
        owners, places = ranges(self.starts[sources], counts)
        exposed = self.clipper.exposed(points[owners], normals[owners], self.order[places])
        whole = fragment_factors(exposed, normals[owners])
        touched, left = self.clipper.unshadowed(exposed, points[owners], blockers[owners])
        seen = np.bincount(owners[exposed.views], np.where(touched, 0, whole), len(points))
        seen += np.bincount(owners[left.views], fragment_factors(left, normals[owners]), len(points))
        return seen.clip(0, 1), np.bincount(owners[exposed.views], whole, len(points)).clip(0, 1)


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
    receivers, sources = smaller_first(areas, first, second)
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


def _heights(loops, normals, others):
    """Heights (m, k) of loops over planes through the first corners of others."""
    return np.einsum("mki,mi->mk", loops - others[:, :1], normals)
