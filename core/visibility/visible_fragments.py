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
from .convex_loops import join, split

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
    rays : (f, k, 3) float64
        Corners relative to the point, in scene sizes; short loops repeat their last corner.
    views : (f,) int64
        View that each belongs to.
    pieces : (f,) int64
        Piece of the tree that each is a part of.
    fronts : (f,) bool
        Whether it is the front that is seen.
    """

    rays: np.ndarray
    views: np.ndarray
    pieces: np.ndarray
    fronts: np.ndarray

    def take(self, rows: np.ndarray) -> Fragments:
        """Some of the fragments."""
        return Fragments(self.rays[rows], self.views[rows], self.pieces[rows], self.fronts[rows])


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
            join([part.rays for part in parts]),
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("views", "pieces", "fronts")),
        )

    def exposed(self, points: np.ndarray, normals: np.ndarray, targets: np.ndarray) -> Fragments:
        """What each view would see of its target if nothing stood between, as by `visible`."""
        pieces = self.tree.pieces
        sides = self._sides(points, targets)
        seen = (sides > 0) | (self.two_sided[targets] & (sides < 0))
        views = np.flatnonzero(seen)
        rays = pieces.loops[targets[views]] - points[views, None]
        rays, rows, _, _ = split(rays, np.einsum("vki,vi->vk", rays, normals[views]), SLIVER)
        views = views[rows]
        return Fragments(rays, views, targets[views], sides[views] > 0)

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
        rays, rows = self._subtract_all(exposed.take(shaded), points, blockers, touched, shaded)
        return touched, Fragments(rays, exposed.views[rows], exposed.pieces[rows], exposed.fronts[rows])

    def _sides(self, points, pieces):
        """Side (...) of points on which they lie of pieces' planes: 1 in front, -1 behind, 0 edge-on."""
        tree = self.tree
        nodes = tree.nodes[pieces]
        # The node's plane serves all its pieces; its normal may be opposite to theirs.
        heights = np.einsum("...i,...i->...", points, tree.normals[nodes]) - tree.offsets[nodes]
        same = np.einsum("...i,...i->...", tree.normals[nodes], tree.pieces.normals[pieces]) > 0
        return np.where(np.abs(heights) <= EDGE_ON, 0, np.where((heights > 0) == same, 1, -1))

    def _subtract_all(self, exposed, points, blockers, touched, names):
        """Parts of exposed polygons (rays and names) outside of all shadows, where `touched` by one, which it notes."""
        tree = self.tree
        points, candidates = points[exposed.views], blockers[exposed.views]
        ranks = tree.ranks(points)
        lines = np.arange(len(points))
        places = ranks[lines[:, None], tree.nodes[candidates]]
        sides = self._sides(points[:, None], candidates)
        before = (candidates >= 0) & (sides != 0)
        before &= places < ranks[lines, tree.nodes[exposed.pieces]][:, None]
        # Near ones first: they hide most, and what is hidden costs nothing more.
        order = np.argsort(np.where(before, places, np.iinfo(np.int32).max), axis=1, kind="stable")
        candidates = np.take_along_axis(candidates, order, axis=1)
        sides = np.take_along_axis(sides, order, axis=1)
        counts = before.sum(axis=1)
        rays, owners, done = exposed.rays, lines, []
        for place in range(counts.max(initial=0)):
            going = counts[owners] > place
            if not going.all():
                done.append((rays[~going], owners[~going]))
                rays, owners = rays[going], owners[going]
            if not len(rays):
                break
            rays, owners, reached = self._subtract(
                rays, owners, candidates[owners, place], sides[owners, place], points[owners]
            )
            touched[names[reached]] = True
        done.append((rays, owners))
        rays, owners = join([part for part, _ in done]), names[np.concatenate([part for _, part in done])]
        left = touched[owners]
        return rays[left], owners[left]

    def _subtract(self, rays, owners, blockers, sides, points):
        """Parts of rays outside of one shadow each, their owners, and the owners of those that it may have reached."""
        corners = self.tree.pieces.loops[blockers] - points[:, None]
        outward = np.cross(corners, np.roll(corners, -1, axis=1)) * sides[:, None, None]
        lengths = np.linalg.norm(outward, axis=2, keepdims=True)
        # An edge without length, which padding adds, bounds nothing.
        real = lengths[:, :, 0] > SLIVER * SLIVER
        outward /= np.where(real[:, :, None], lengths, 1)
        heights = np.matmul(outward, rays.transpose(0, 2, 1))
        apart = (real & (heights >= -SLIVER).all(axis=2)).any(axis=1)
        kept = [(rays[apart], owners[apart])]
        inner, rows = rays[~apart], np.flatnonzero(~apart)
        reached = owners[rows]
        for edge in range(outward.shape[1]):
            if not len(rows):
                break
            plane = outward[rows, edge]
            values = np.where(real[rows, edge][:, None], np.einsum("fki,fi->fk", inner, plane), -1.0)
            outside, outside_rows, inside, inside_rows = split(inner, values, SLIVER)
            kept.append((outside, owners[rows[outside_rows]]))
            inner, rows = inside, rows[inside_rows]
        kept = [(part, owner) for part, owner in kept if len(part)]
        if not kept:
            return rays[:0], owners[:0], reached
        return join([part for part, _ in kept]), np.concatenate([owner for _, owner in kept]), reached


def fragment_factors(fragments: Fragments, normals: np.ndarray) -> np.ndarray:
    """Configuration factor (f,) of each fragment from its view's differential area, in closed form.

    Lambert's sum over edges, as in `point_to_polygon`; the fragments are clipped at the horizon already.

    Parameters
    ----------
    fragments : Fragments
    normals : (v, 3) float
        Unit normals of the views' areas.
    """
    rays = fragments.rays
    following = np.roll(rays, -1, axis=1)
    crosses = np.cross(rays, following)
    lengths = np.sqrt(np.einsum("fki,fki->fk", crosses, crosses))
    angles = np.arctan2(lengths, np.einsum("fki,fki->fk", rays, following))
    along = np.einsum("fki,fi->fk", crosses, normals[fragments.views])
    total = (angles * along / np.where(lengths > 0, lengths, 1)).sum(axis=1)
    return np.maximum(np.where(fragments.fronts, -total, total) / (2 * np.pi), 0)
