"""BSP tree: space parted by the planes of the polygons themselves, which sorts them from any point without a depth.

Polygons that a plane crosses are cut; those in the plane stay at its node. From a point, the polygons of the near side
of each plane come before the node's own, and these before the far side's: nothing later can hide anything earlier. On
this order stands the exact clipping of `visible_fragments`. For segments, the tree finds the polygons that they may
cross; all is float64, without a ray engine.

Choose it where embreex does not exist, or where visibility must be exact. Building costs about n log n with a large
constant (1,000 polygons in half a second); a segment visits about as many nodes as planes it crosses.

Limits: the cuts may multiply the polygons, by 2 or 3 in furnished rooms; a plane is chosen to cut few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from .convex_loops import ConvexPieces, convex_pieces, join, split

#: Height over a plane, in scene sizes, up to which a corner lies in it. A thousand roundings of unit coordinates, and
#: far below the gaps that must not close (1e-6 of the size).
TOLERANCE = 1e-11

#: Planes tried at each node, and polygons they are tried on: more changed the size of the trees by less than a tenth.
CANDIDATES = 12
SAMPLE = 256

#: A polygon that is cut weighs as much as this many polygons of imbalance: cuts cost in all that follows.
CUT_COST = 8

#: Share of the scene's size next to a segment's ends within which nothing blocks: its ends lie on surfaces up to
#: rounding.
END_MARGIN = 1e-9

#: Segments per block: the temporaries of a block stay near 20 MB.
BLOCK_SEGMENTS = 65536


@dataclass(frozen=True)
class BspTree:
    """A BSP tree as arrays, in the unit frame of its pieces.

    Attributes
    ----------
    pieces : ConvexPieces
        The polygons as cut by the tree, ordered by node.
    normals : (n, 3) float64
    offsets : (n,) float64
        Planes of the nodes: ``x @ normal == offset``.
    children : (n, 2) int64
        Node in front and behind, -1 for none. Nodes come after their parents.
    starts : (n + 1,) int64
        Pieces of node v are rows ``starts[v]`` to ``starts[v + 1]``.
    nodes : (m,) int64
        Node of each piece.
    levels : tuple of (l,) int64
        Nodes by depth.
    sizes : (n,) int64
        Nodes in each subtree.
    """

    pieces: ConvexPieces
    normals: np.ndarray
    offsets: np.ndarray
    children: np.ndarray
    starts: np.ndarray
    nodes: np.ndarray
    levels: tuple[np.ndarray, ...]
    sizes: np.ndarray

    @classmethod
    def build(cls, environment: Environment) -> BspTree:
        """Tree of all patches that have an area."""
        pieces = convex_pieces(environment)
        normals, offsets, children, held, depths = [], [], [], [], []
        stack = [(pieces.loops, pieces.patches, -1, 0, 0)] if len(pieces.loops) else []
        while stack:
            loops, patches, parent, side, depth = stack.pop()
            node = len(normals)
            if parent >= 0:
                children[parent][side] = node
            plane = _splitting_plane(loops, environment.normals[patches])
            normals.append(plane[0])
            offsets.append(plane[1])
            children.append([-1, -1])
            depths.append(depth)
            heights = loops @ plane[0] - plane[1]
            inside = (np.abs(heights) <= TOLERANCE).all(axis=1)
            # The chosen polygon itself stays, however bent: else nothing might, and the tree would not end.
            inside[plane[2]] = True
            held.append((loops[inside], patches[inside]))
            above, above_rows, below, below_rows = split(loops[~inside], heights[~inside], TOLERANCE)
            others = patches[~inside]
            for part, rows, place in ((below, below_rows, 1), (above, above_rows, 0)):
                if len(rows):
                    stack.append((part, others[rows], node, place, depth + 1))
        return cls._from_nodes(environment, pieces, normals, offsets, children, held, np.array(depths, dtype=int))

    @classmethod
    def _from_nodes(cls, environment, pieces, normals, offsets, children, held, depths):
        counts = [len(part) for _, part in held]
        loops = join([part for part, _ in held]) if held else pieces.loops
        patches = np.concatenate([part for _, part in held]) if held else pieces.patches
        children = np.array(children, dtype=np.int64).reshape(-1, 2)
        sizes = np.ones(len(children), dtype=np.int64)
        for node in range(len(children) - 1, -1, -1):
            sizes[node] += sizes[children[node][children[node] >= 0]].sum()
        return cls(
            pieces=ConvexPieces(loops, patches, environment.normals[patches], pieces.center, pieces.size),
            normals=np.array(normals).reshape(-1, 3),
            offsets=np.array(offsets, dtype=np.float64),
            children=children,
            starts=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
            nodes=np.repeat(np.arange(len(held)), counts),
            levels=tuple(np.flatnonzero(depths == depth) for depth in range(depths.max(initial=-1) + 1)),
            sizes=sizes,
        )

    def ranks(self, points: np.ndarray) -> np.ndarray:
        """Place (p, n) of every node in the order from near to far, for points (p, 3) of the unit frame.

        What a node holds can be hidden only by nodes of lower rank.
        """
        fronts = points @ self.normals.T >= self.offsets
        ranks = np.zeros((len(points), len(self.normals)), dtype=np.int32)
        # Until a node is reached, its entry holds the rank at which its subtree begins.
        sizes = np.append(self.sizes, 0)
        for nodes in self.levels:
            first, front = ranks[:, nodes], fronts[:, nodes]
            before, behind = self.children[nodes, 0], self.children[nodes, 1]
            own = first + np.where(front, sizes[before], sizes[behind])
            ranks[:, nodes] = own
            for child, near in ((before, front), (behind, ~front)):
                there = np.flatnonzero(child >= 0)
                ranks[:, child[there]] = np.where(near, first, own + 1)[:, there]
        return ranks


def _splitting_plane(loops: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Normal, offset and row of the polygon whose plane cuts few others and balances the rest."""
    count = len(loops)
    tried = np.unique(np.linspace(0, count - 1, min(CANDIDATES, count)).astype(int))
    offsets = np.einsum("cki,ci->c", loops[tried], normals[tried]) / loops.shape[1]
    if count > 2:
        sample = np.unique(np.linspace(0, count - 1, min(SAMPLE, count)).astype(int))
        heights = np.einsum("ski,ci->csk", loops[sample], normals[tried]) - offsets[:, None, None]
        up, down = (heights > TOLERANCE).any(axis=2), (heights < -TOLERANCE).any(axis=2)
        cuts = (up & down).sum(axis=1)
        cost = CUT_COST * cuts + np.abs(up.sum(axis=1) - down.sum(axis=1))
        best = int(np.argmin(cost))
    else:
        best = 0
    return normals[tried[best]], float(offsets[best]), int(tried[best])


class BspVisibility:
    """Segments through a BSP tree of an environment.

    Parameters
    ----------
    environment : Environment
    tree : BspTree, optional
        One that exists already.
    """

    def __init__(self, environment: Environment, tree: BspTree | None = None):
        self.tree = BspTree.build(environment) if tree is None else tree
        loops, normals = self.tree.pieces.loops, self.tree.pieces.normals
        edges = np.roll(loops, -1, axis=1) - loops
        lengths = np.linalg.norm(edges, axis=2, keepdims=True)
        # Unit vectors in each piece's plane that point out over an edge; 0 for the edges that padding adds.
        self.outward = np.cross(edges / np.where(lengths > 0, lengths, 1), normals[:, None])
        self.limits = np.einsum("mki,mki->mk", self.outward, loops) + TOLERANCE
        self.rays = 0

    def visible(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(n,) bool: whether the open segment from each origin (n, 3) to its target (n, 3) meets no polygon.

        A polygon includes its border, so segments through a seam of two are blocked.
        """
        origins, targets = np.asarray(origins, dtype=np.float64), np.asarray(targets, dtype=np.float64)
        free = np.ones(len(origins), dtype=bool)
        for start in range(0, len(origins), BLOCK_SEGMENTS):
            stop = start + BLOCK_SEGMENTS
            ends = self.tree.pieces.to_unit(origins[start:stop]), self.tree.pieces.to_unit(targets[start:stop])
            free[start:stop] = self._block(*ends)
        self.rays += len(origins)
        return free

    def _block(self, origins, targets):
        tree = self.tree
        free = np.ones(len(origins), dtype=bool)
        if not len(tree.normals):
            return free
        lengths = np.linalg.norm(targets - origins, axis=1)
        margins = END_MARGIN / np.where(lengths > 0, lengths, 1)
        everything = np.arange(len(origins))
        stack = [(0, everything, np.zeros(len(origins)), np.ones(len(origins)))]
        while stack:
            node, rows, first, last = stack.pop()
            alive = free[rows]
            rows, first, last = rows[alive], first[alive], last[alive]
            if not len(rows):
                continue
            normal, offset = tree.normals[node], tree.offsets[node]
            here, there = origins[rows] @ normal - offset, targets[rows] @ normal - offset
            crossing = (here > 0) != (there > 0)
            share = np.where(crossing, here, 0) / np.where(crossing, here - there, 1)
            cut = crossing & (share >= first - margins[rows]) & (share <= last + margins[rows])
            inner = cut & (share > margins[rows]) & (share < 1 - margins[rows])
            hits = np.flatnonzero(inner)
            if len(hits):
                chosen = rows[hits]
                places = origins[chosen] + share[hits, None] * (targets[chosen] - origins[chosen])
                free[chosen] = ~self._covered(node, places)
            # Where in its part the segment lies on one side only: the side of the part's middle.
            middle = here + (first + last) / 2 * (there - here) > 0
            begins, ends = np.where(cut, here > 0, middle), np.where(cut, there > 0, middle)
            for side, place in ((True, 0), (False, 1)):
                child = tree.children[node, place]
                if child < 0:
                    continue
                chosen = np.flatnonzero((begins == side) | (ends == side))
                if len(chosen):
                    # A part that is cut ends, on the side it starts on, at the plane, and starts there on the other.
                    stops = np.where(cut & (ends != side), np.minimum(share, last), last)[chosen]
                    starts = np.where(cut & (begins != side), np.maximum(share, first), first)[chosen]
                    stack.append((child, rows[chosen], starts, stops))
        return free

    def _covered(self, node, places):
        """(p,) bool: whether places on a node's plane lie in one of its polygons."""
        pieces = slice(*self.tree.starts[node : node + 2])
        outward, limits = self.outward[pieces], self.limits[pieces]
        covered = np.zeros(len(places), dtype=bool)
        block = max(1, 2**20 // max(limits.size, 1))
        for start in range(0, len(places), block):
            heights = np.einsum("pi,mki->pmk", places[start : start + block], outward, optimize=True)
            covered[start : start + block] = (heights <= limits).all(axis=2).any(axis=1)
        return covered
