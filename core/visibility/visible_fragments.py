"""Exact front-to-back clipping: which parts of a polygon are visible from a point, as convex polygons.

The BSP tree tells which polygons come before another, seen from the point; each of these casts a shadow bounded by the
planes through the point and its edges, and what lies in no shadow is visible. The order replaces every test of depth,
so that touching and nearly coincident polygons need no tolerance between them. This is the shadow-volume clipping of
Chin and Feiner [1]_ without their second tree: views are many here and polygons few, so all fragments of all views are
clipped by one edge at a time, in whole arrays.

Choose it where form factors must be exact: the visible area is, to rounding. The cost is fragments times blockers
before them, some 5 microseconds each where they overlap: it serves pairs and small environments, not large ones.

Limits: a polygon seen exactly edge-on hides nothing, and is not seen.

References
----------
.. [1] Chin, Feiner, "Near Real-Time Shadow Generation Using BSP Trees", SIGGRAPH 1989.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .bsp import BspTree
from .loop_columns import LoopColumns, concatenate, split

#: Height of a fragment's corners over a shadow's plane, in scene sizes, that counts as none. Fragments thinner than
#: this are lost; some ten thousand roundings.
SLIVER = 1e-12

#: Height of a point over a polygon's plane, in scene sizes, below which the polygon is edge-on: it neither shows nor
#: hides. It must exceed the tree's own tolerance, within which corners may lie off the plane.
EDGE_ON = 1e-10


@dataclass(frozen=True)
class Fragments:
    """Visible parts of polygons, each seen from one point.

    Attributes
    ----------
    loops : LoopColumns
        Corners (3, k, f) relative to the point, in scene sizes.
    views : (f,) int64
        View that each belongs to.
    pieces : (f,) int64
        Piece of the tree that each is a part of.
    fronts : (f,) bool
        Whether it is the front that is seen.
    """

    loops: LoopColumns
    views: np.ndarray
    pieces: np.ndarray
    fronts: np.ndarray

    @property
    def rays(self) -> np.ndarray:
        """(f, k, 3) corners relative to the point, the last repeated in short loops."""
        return self.loops.corners.transpose(2, 1, 0)

    def take(self, rows: np.ndarray) -> Fragments:
        """Some of the fragments."""
        return Fragments(self.loops.take(rows), self.views[rows], self.pieces[rows], self.fronts[rows])


class FragmentClipper:
    """Clips polygons of a tree by all that comes before them.

    Parameters
    ----------
    tree : BspTree
    two_sided : (n,) bool
        For each patch, whether its back is seen too.
    """

    def __init__(self, tree: BspTree, two_sided: np.ndarray):
        self.tree = tree
        self.two_sided = two_sided[tree.pieces.patches]
        loops = tree.pieces.loops
        repeated = (loops[:, 1:] == loops[:, :-1]).all(axis=2)
        self._loops = LoopColumns(np.ascontiguousarray(loops.transpose(2, 1, 0)), loops.shape[1] - repeated.sum(axis=1))
        nodes = tree.nodes
        # A node's plane serves all its pieces; its normal may be opposite to theirs.
        same = np.einsum("mi,mi->m", tree.normals[nodes], tree.pieces.normals) > 0
        signs = np.where(same, 1.0, -1.0)
        self._planes = (tree.normals[nodes] * signs[:, None]).T.copy(), tree.offsets[nodes] * signs

    def visible(self, points: np.ndarray, normals: np.ndarray, targets: np.ndarray, blockers: np.ndarray) -> Fragments:
        """What each view sees of its target.

        Parameters
        ----------
        points, normals : (v, 3) float
            Of each view: where from, in the tree's unit frame, and the direction of the horizon; what lies below the
            horizon is not seen.
        targets : (v,) int
            Piece of the tree looked at.
        blockers : (v, b) int
            Pieces that may hide it, in any order, -1 for none.
        """
        exposed = self.exposed(points, normals, targets)
        touched, left = self.unshadowed(exposed, points, blockers)
        parts = (exposed.take(~touched), left)
        return Fragments(
            concatenate([part.loops for part in parts]),
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("views", "pieces", "fronts")),
        )

    def exposed(self, points: np.ndarray, normals: np.ndarray, targets: np.ndarray) -> Fragments:
        """What each view would see of its target if nothing stood between, as by `visible`; each at most one loop."""
        sides = self._sides(points.T, targets)
        views = np.flatnonzero((sides > 0) | (self.two_sided[targets] & (sides < 0)))
        loops = self._seen(targets[views], points[views].T)
        loops, columns, _, _ = split(loops, loops.heights(normals[views].T), SLIVER)
        views = views[columns]
        return Fragments(loops, views, targets[views], sides[views] > 0)

    def unshadowed(self, exposed: Fragments, points: np.ndarray, blockers: np.ndarray):
        """What blockers leave of exposed polygons; points and blockers are those of `visible`.

        Returns
        -------
        touched : (f,) bool
            Which of the polygons a shadow may have reached. The others are visible as they are.
        left : Fragments
            What is visible of those.
        """
        touched = np.zeros(len(exposed.views), dtype=bool)
        shaded = np.flatnonzero((blockers[exposed.views] >= 0).any(axis=1))
        loops, rows = self._subtract_all(exposed.take(shaded), points, blockers, touched, shaded)
        return touched, Fragments(loops, exposed.views[rows], exposed.pieces[rows], exposed.fronts[rows])

    def _seen(self, pieces, points):
        """Loops of pieces (m,) relative to points (3, m)."""
        loops = self._loops.take(pieces)
        return LoopColumns(loops.corners - points[:, None], loops.sizes)

    def _sides(self, points, pieces):
        """Side (...) of points (3, ...) on which they lie of pieces' planes: 1 in front, -1 behind, 0 edge-on."""
        (x, y, z), offsets = (plane[..., pieces] for plane in self._planes)
        heights = points[0] * x + points[1] * y + points[2] * z - offsets
        return np.where(np.abs(heights) <= EDGE_ON, 0.0, np.sign(heights))

    def _subtract_all(self, exposed, points, blockers, touched, names):
        """Loops and names of what all shadows leave of exposed polygons that one reaches, as `touched` notes."""
        tree = self.tree
        points, candidates = points[exposed.views], blockers[exposed.views]
        ranks = tree.ranks(points)
        lines = np.arange(len(points))
        places = ranks[lines[:, None], tree.nodes[candidates]]
        points = np.ascontiguousarray(points.T)
        sides = self._sides(points[:, :, None], candidates)
        before = (candidates >= 0) & (sides != 0)
        before &= places < ranks[lines, tree.nodes[exposed.pieces]][:, None]
        # Near ones first: they hide most, and what is hidden costs nothing more.
        order = np.argsort(np.where(before, places, np.iinfo(np.int32).max), axis=1, kind="stable")
        candidates = np.take_along_axis(candidates, order, axis=1)
        sides = np.take_along_axis(sides, order, axis=1)
        counts = before.sum(axis=1)
        turns = np.where(exposed.fronts, 1.0, -1.0)
        loops, owners, done = exposed.loops, lines, []
        for place in range(counts.max(initial=0)):
            going = counts[owners] > place
            if not going.all():
                done.append((loops.take(~going), owners[~going]))
                loops, owners = loops.take(going), owners[going]
            if not len(owners):
                break
            shadows = self._seen(candidates[owners, place], points[:, owners])
            loops, columns, reached = _subtract(loops, turns[owners], shadows, sides[owners, place])
            touched[names[owners[reached]]] = True
            owners = owners[columns]
        done.append((loops, owners))
        loops, owners = concatenate([part for part, _ in done]), names[np.concatenate([part for _, part in done])]
        left = touched[owners]
        return loops.take(left), owners[left]


def _outward(loops, turns):
    """Unit normals (3, k, m) that point out of the cones over loops, 0 for edges without length, which padding adds."""
    x, y, z = loops.corners
    following = np.append(np.arange(1, x.shape[0]), 0)
    u, v, w = x[following], y[following], z[following]
    normals = np.stack((y * w - z * v, z * u - x * w, x * v - y * u))
    lengths = np.sqrt((normals * normals).sum(axis=0))
    real = lengths > SLIVER * SLIVER
    return normals * (turns * real / np.where(real, lengths, 1))


def _apart(normals, loops):
    """(m,) bool: whether a plane (3, k, m) through the eye has a whole loop outside."""
    x, y, z = loops.corners
    lowest = None
    for corner in range(x.shape[0]):
        heights = normals[0] * x[corner] + normals[1] * y[corner] + normals[2] * z[corner]
        lowest = heights if lowest is None else np.minimum(lowest, heights)
    # No normal, no plane.
    return ((lowest >= -SLIVER) & (normals != 0).any(axis=0)).any(axis=0)


def _subtract(loops, turns, shadows, sides):
    """Parts of loops outside of the shadow of another each, the loop each is from, and which the shadow reaches."""
    outward = _outward(shadows, sides)
    reached = np.flatnonzero(~_apart(outward, loops))
    # Of two convex polygons that are apart, an edge of one or the other parts them.
    reached = reached[~_apart(_outward(loops.take(reached), turns[reached]), shadows.take(reached))]
    apart = np.ones(len(turns), dtype=bool)
    apart[reached] = False
    kept, columns = [loops.take(apart)], [np.flatnonzero(apart)]
    inner, rows, outward = loops.take(reached), reached, outward[:, :, reached]
    for edge in range(outward.shape[1]):
        if not len(rows):
            break
        planes = outward[:, edge]
        heights = np.where((planes != 0).any(axis=0), inner.heights(planes), -1.0)
        outside, outside_columns, inner, inside = split(inner, heights, SLIVER)
        kept.append(outside)
        columns.append(rows[outside_columns])
        rows, outward = rows[inside], outward[:, :, inside]
    return concatenate(kept), np.concatenate(columns), reached


def fragment_factors(fragments: Fragments, normals: np.ndarray) -> np.ndarray:
    """Configuration factor (f,) of each fragment from its view's differential area, in closed form.

    Lambert's sum over edges, as in `point_to_polygon`; the fragments are clipped at the horizon already.

    Parameters
    ----------
    fragments : Fragments
    normals : (v, 3) float
        Unit normals of the views' areas.
    """
    x, y, z = fragments.loops.corners
    following = np.append(np.arange(1, x.shape[0]), 0)
    u, v, w = x[following], y[following], z[following]
    crosses = y * w - z * v, z * u - x * w, x * v - y * u
    lengths = np.sqrt(crosses[0] ** 2 + crosses[1] ** 2 + crosses[2] ** 2)
    angles = np.arctan2(lengths, x * u + y * v + z * w)
    nx, ny, nz = normals[fragments.views].T
    along = crosses[0] * nx + crosses[1] * ny + crosses[2] * nz
    total = (angles * along / np.where(lengths > 0, lengths, 1)).sum(axis=0)
    return np.maximum(np.where(fragments.fronts, -total, total) / (2 * np.pi), 0)
