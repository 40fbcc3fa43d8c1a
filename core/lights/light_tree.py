"""Binary tree over emissive triangles: many small sources answered for by few, where they are far (Walter et al. 2005).

A node stands for its triangles as one small flat source at their middle, with their vector area. That is used where the
node is far against its size, lies wholly above the receiver's horizon, and all its triangles turn the same side to the
receiver, so that none is wrongly counted; else its two children are asked, and a single triangle that is near gets its
closed form. So the sum is exact nearby and smooth everywhere, and the nodes that a receiver asks grow as the outline of
the light, the square root of its triangles. Cost: O(t log t) to build, about 0.1 microseconds per node asked.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..form_factors.point_to_polygon import point_to_polygon

#: Distance in radii of a node from which it counts as far. The error of taking its triangles at one place is below 2 %
#: of the nearest nodes, measured on spheres, and below 1 % RMS of the sum of all.
FAR = 10.0

#: Sine of the turn within which it does not matter: seen edge-on, such a node gives little, whichever side it shows.
SLIGHT = 0.2

#: Weight of the direction a triangle faces beside its place when triangles are grouped, in extents of the light.
FACING = 0.5

#: Differences of place and direction that count as none, in extents of the light.
TIE = 1e-9

#: Receivers handled at a time: some tens of nodes each stay within some tens of MB.
BLOCK = 8192


@dataclass(frozen=True)
class LightTree:
    """Nodes of the tree, the root first; triangles are in the order of the leaves.

    Attributes
    ----------
    triangles : (t, 3, 3) float64
    intensities : (t,) float64
        Relative exitance of each triangle.
    starts, stops : (2 t - 1,) int64
        Triangles of each node.
    children : (2 t - 1,) int64
        First of each node's two children, which follow each other; -1 for a leaf.
    centers : (2 t - 1, 3) float64
    radii : (2 t - 1,) float64
    vectors : (2 t - 1, 3) float64
        Sum of vector areas times intensity.
    sizes : (2 t - 1,) float64
        Lengths of these.
    spreads : (2 t - 1,) float64
        Sine of the largest angle between a triangle's normal and the sum, infinite from a right angle on.
    """

    triangles: np.ndarray
    intensities: np.ndarray
    starts: np.ndarray
    stops: np.ndarray
    children: np.ndarray
    centers: np.ndarray
    radii: np.ndarray
    vectors: np.ndarray
    sizes: np.ndarray
    spreads: np.ndarray

    @classmethod
    def of(cls, triangles: np.ndarray, intensities: np.ndarray) -> LightTree:
        """Tree of (t, 3, 3) triangles with (t,) intensities above 0."""
        vectors = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        order, starts, stops, children = _split(_features(triangles, vectors))
        triangles, intensities, vectors = triangles[order], intensities[order], vectors[order]
        weights = np.linalg.norm(vectors, axis=1) * intensities
        power = _sums(weights, starts, stops)
        middles = _sums(weights[:, None] * triangles.mean(axis=1), starts, stops) / power[:, None]
        total = _sums(vectors * intensities[:, None], starts, stops)
        sizes = np.linalg.norm(total, axis=1)
        axes = total / np.maximum(sizes, 1e-300)[:, None]
        normals = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
        reaches, turns = [], []
        for nodes, rows, bounds in _levels(starts, stops):
            owner = np.repeat(nodes, np.diff(np.append(bounds, len(rows))))
            far = np.linalg.norm(triangles[rows] - middles[owner][:, None], axis=2).max(axis=1)
            reaches.append(np.maximum.reduceat(far, bounds))
            turns.append(np.minimum.reduceat(np.einsum("ij,ij->i", normals[rows], axes[owner]), bounds))
        cosines = np.concatenate(turns)
        return cls(
            triangles=triangles,
            intensities=intensities,
            starts=starts,
            stops=stops,
            children=children,
            centers=middles,
            radii=np.concatenate(reaches),
            vectors=total,
            sizes=sizes,
            spreads=np.where(cosines > 0, np.sqrt(np.maximum(1 - cosines**2, 0)), np.inf),
        )

    def configuration_factors(self, points: np.ndarray, normals: np.ndarray, two_sided: bool) -> np.ndarray:
        """(n,) sum over all triangles of intensity times unoccluded factor, at (n, 3) points with (n, 3) normals."""
        out = np.zeros(len(points))
        for start in range(0, len(points), BLOCK):
            part = slice(start, start + BLOCK)
            out[part] = self._block(
                np.asarray(points[part], dtype=np.float64), np.asarray(normals[part], dtype=np.float64), two_sided
            )
        return out

    def _block(self, points, normals, two_sided):
        total = np.zeros(len(points))
        who, node = np.arange(len(points)), np.zeros(len(points), np.int64)
        near_who, near_node = [], []
        while len(who):
            way = self.centers[node] - points[who]
            square = np.einsum("ij,ij->i", way, way)
            rise = np.einsum("ij,ij->i", way, normals[who])
            lean = -np.einsum("ij,ij->i", way, self.vectors[node])
            radius, leaf, distance = self.radii[node], self.children[node] < 0, np.sqrt(square)
            # By how far the node would have to turn, or the receiver to move, before a triangle showed its other side.
            turn = self.spreads[node] + radius / distance
            # A body whose sides cancel to the last bit has no size and no axis: nothing is known of what it shows.
            known = np.isfinite(turn)
            slack = np.where(known, np.where(known, turn, 0) * distance * self.sizes[node], np.inf)
            visible = (rise > -radius) & (two_sided | (lean > -slack))
            far = visible & (distance > FAR * radius) & (rise >= radius)
            far &= leaf | (np.abs(lean) > slack) | (turn < SLIGHT)
            lean = np.abs(lean) if two_sided else np.maximum(lean, 0)
            here = who[far]
            total += np.bincount(here, weights=(lean * rise / (np.pi * square**2))[far], minlength=len(points))
            near = visible & ~far & leaf
            near_who.append(who[near])
            near_node.append(node[near])
            onward = visible & ~far & ~leaf
            first = self.children[node[onward]]
            who, node = np.concatenate([who[onward], who[onward]]), np.concatenate([first, first + 1])
        self._add_near(total, points, normals, np.concatenate(near_who), np.concatenate(near_node), two_sided)
        return total

    def _add_near(self, total, points, normals, who, node, two_sided):
        triangle = self.starts[node]
        order = np.argsort(triangle, kind="stable")
        who, triangle = who[order], triangle[order]
        bounds = np.flatnonzero(np.diff(triangle, prepend=-1, append=-1))
        for start, stop in itertools.pairwise(bounds):
            row, mine = triangle[start], who[start:stop]
            factors = point_to_polygon(points[mine], normals[mine], self.triangles[row], two_sided)
            total[mine] += self.intensities[row] * factors


def _features(triangles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(t, 6) places and directions by which triangles are grouped."""
    middles = triangles.mean(axis=1)
    extent = float(np.ptp(middles, axis=0).max()) if len(middles) else 0.0
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    places = (middles - middles.mean(axis=0)) / max(extent, 1e-300)
    # Rounded, so that the ties of symmetric meshes are broken alike wherever the light stands and however large it is.
    return np.rint(np.concatenate([places, FACING * vectors / np.maximum(lengths, 1e-300)], axis=1) / TIE)


def _split(features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Order of the triangles, and start, stop and first child of each node, level by level: every segment of more than
    one is halved across its widest feature."""
    count = len(features)
    order = np.arange(count)
    starts, stops, children = [np.array([0])], [np.array([count])], []
    cuts, is_open = np.array([0]), np.array([0])  # all segments; which of them are nodes of the last level
    made = 1
    while True:
        lengths = np.diff(np.append(cuts, count))
        inner = lengths[is_open] > 1
        first = np.where(inner, made + 2 * (np.cumsum(inner) - 1), -1)
        children.append(first)
        if not inner.any():
            break
        here = features[order]
        spans = np.maximum.reduceat(here, cuts) - np.minimum.reduceat(here, cuts)
        segment = np.repeat(np.arange(len(cuts)), lengths)
        order = order[np.lexsort((here[np.arange(count), spans.argmax(axis=1)[segment]], segment))]
        split = is_open[inner]
        begin, end = cuts[split], cuts[split] + lengths[split]
        middle = (begin + end) // 2
        starts.append(np.column_stack([begin, middle]).ravel())
        stops.append(np.column_stack([middle, end]).ravel())
        made += 2 * len(split)
        cuts = np.sort(np.concatenate([cuts, middle]))
        is_open = np.searchsorted(cuts, starts[-1])
    return order, np.concatenate(starts), np.concatenate(stops), np.concatenate(children)


def _sums(values: np.ndarray, starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Sums of values (t, ...) over each node's triangles."""
    # Pairs of bounds, every second sum is that of a node; the end itself has no row to start a sum at.
    padded = np.concatenate([values, np.zeros_like(values[:1])])
    return np.add.reduceat(padded, np.column_stack([starts, stops]).ravel())[::2]


def _levels(starts: np.ndarray, stops: np.ndarray):
    """Of each level in turn, whose nodes share no triangle: its nodes, their triangles' rows, and where in these each
    node's begin."""
    # A level ends where a node starts no later than the one before it.
    ends = np.append(np.flatnonzero(np.diff(starts) <= 0) + 1, len(starts))
    begin = 0
    for end in ends:
        nodes = np.arange(begin, end)
        lengths = stops[nodes] - starts[nodes]
        bounds = np.cumsum(lengths) - lengths
        yield nodes, np.arange(lengths.sum()) + np.repeat(starts[nodes] - bounds, lengths), bounds
        begin = end
