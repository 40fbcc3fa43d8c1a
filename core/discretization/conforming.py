"""Triangles of a hierarchy's elements that fit together without gaps: no vertex lies inside another triangle's side.

In a balanced hierarchy a side of an element has at most one vertex of smaller neighbors, in its middle. An element
becomes a fan of triangles around such a vertex, or around its first corner where it has none. Nothing is added: the
vertices are the elements' corners.

Choose it to show a solution by interpolation. Cost: O(elements log elements). Limits: those of the hierarchy's
neighbors; where it ran out of elements before it was balanced, the quarters of sides stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .hierarchy import Hierarchy, numbered


@dataclass(frozen=True)
class ConformingMesh:
    """Triangles and vertices; a place where surfaces meet is a vertex for each.

    Attributes
    ----------
    vertices : (v, 3) float64
    surfaces : (v,) int64
        Surface of each vertex.
    triangles : (t, 3) int64
        Rows of `vertices`, counter-clockwise.
    elements : (t,) int64
        Place in `Hierarchy.elements` of the element that each triangle is part of, ascending.
    areas : (t,) float64
    """

    vertices: np.ndarray
    surfaces: np.ndarray
    triangles: np.ndarray
    elements: np.ndarray
    areas: np.ndarray

    def vertex_values(self, values: np.ndarray) -> np.ndarray:
        """(v, c) means of elements' values (q, c) over the triangles at each vertex, by their areas."""
        sums = np.zeros((len(self.vertices), 1 + values.shape[1]))
        shares = np.column_stack((np.ones(len(values)), values))[self.elements] * self.areas[:, None]
        for corner in range(3):
            np.add.at(sums, self.triangles[:, corner], shares)
        return sums[:, 1:] / sums[:, :1]


def conforming_mesh(hierarchy: Hierarchy) -> ConformingMesh:
    """Triangles of all elements."""
    elements = hierarchy.elements
    starts, ends, owners = hierarchy.sides(elements)
    first, middle = numbered([starts, (starts + ends) / 2])
    split = np.isin(middle, first)
    # Loops of corners, each followed by the middle of its side where that is a vertex.
    places = np.stack((starts, (starts + ends) / 2), axis=1).reshape(-1, 3)
    kept = np.column_stack((np.ones(len(split), dtype=bool), split)).reshape(-1)
    corners, owner, inserted = places[kept], np.repeat(owners, 2)[kept], np.tile((False, True), len(split))[kept]
    _, rows, numbers = np.unique(
        np.column_stack((hierarchy.surfaces[elements[owner]], corners)), axis=0, return_index=True, return_inverse=True
    )
    numbers = numbers.reshape(-1)
    counts = np.bincount(owner, minlength=len(elements))
    offsets = np.cumsum(counts) - counts
    # The fan's center: the first middle, or else the first corner.
    ranks = np.arange(len(owner)) - offsets[owner]
    center = np.full(len(elements), counts.max(initial=0))
    np.minimum.at(center, owner[inserted], ranks[inserted])
    center = np.where(center < counts, center, 0)
    fans = counts - 2
    member = np.repeat(np.arange(len(elements)), fans)
    step = np.arange(len(member)) - np.repeat(np.cumsum(fans) - fans, fans)
    turns = np.stack((np.zeros(len(step), dtype=np.int64), step + 1, step + 2), axis=1)
    around = offsets[member, None] + (center[member, None] + turns) % counts[member, None]
    vertices, triangles = corners[rows], numbers[around]
    edges = vertices[triangles[:, 1:]] - vertices[triangles[:, :1]]
    return ConformingMesh(
        vertices=vertices,
        surfaces=hierarchy.surfaces[elements[owner[rows]]],
        triangles=triangles,
        elements=member,
        areas=np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2,
    )
