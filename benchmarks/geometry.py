"""Flat quadrilaterals cut into grids, as Blender meshes: the stuff the benchmark scenes are made of.

Every quadrilateral has vertices of its own, so a vertex belongs to one plane and a point attribute holds one value per
receiver. Which vertices are fair receivers is stored with the mesh: a bake by Cycles samples exactly at the vertex, so
one on the border of its plane, or inside or against a solid, measures self-occlusion and not light.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

#: Boolean point attribute: vertices inside a plane and outside of all solids.
INTERIOR = "interior"

#: Distance in units of the mesh's longest side up to which a vertex counts as touching a solid.
_CONTACT = 1e-5


@dataclass(frozen=True)
class Solid:
    """An upright prism: a convex footprint (k, 2), counter-clockwise from above, between two heights."""

    footprint: np.ndarray
    low: float
    high: float

    def holds(self, points: np.ndarray, margin: float) -> np.ndarray:
        """(n,) bool: points inside, or within `margin` of it."""
        inside = (points[:, 2] > self.low - margin) & (points[:, 2] < self.high + margin)
        for start, end in zip(self.footprint, np.roll(self.footprint, -1, axis=0), strict=True):
            along = (end - start) / np.linalg.norm(end - start)
            inside &= along[0] * (points[:, 1] - start[1]) - along[1] * (points[:, 0] - start[0]) > -margin
        return inside


@dataclass
class Model:
    """Collects quadrilaterals, then makes one mesh object of them."""

    quads: list[np.ndarray] = field(default_factory=list)  # (4, 3) each, counter-clockwise from the front
    materials: list[int] = field(default_factory=list)
    owners: list[int] = field(default_factory=list)  # solid that the quadrilateral is a side of, -1 for none
    solids: list[Solid] = field(default_factory=list)

    def add(self, corners, material: int, away_from=None, towards=None, owner: int = -1) -> None:
        """Add a planar quadrilateral; `away_from` or `towards` is a point that decides which side is its front."""
        corners = np.asarray(corners, dtype=float)
        normal = np.cross(corners[2] - corners[0], corners[3] - corners[1])
        if away_from is not None and normal @ (corners.mean(axis=0) - away_from) < 0:
            corners = corners[::-1]
        if towards is not None and normal @ (towards - corners.mean(axis=0)) < 0:
            corners = corners[::-1]
        self.quads.append(corners)
        self.materials.append(material)
        self.owners.append(owner)

    def rectangle(self, low, high, material: int, **side) -> None:
        """Add an axis-aligned rectangle: `low` and `high` agree in one coordinate."""
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        first, second = np.nonzero(low != high)[0]
        corners = np.tile(low, (4, 1))
        corners[1:3, first] = high[first]
        corners[2:4, second] = high[second]
        self.add(corners, material, **side)

    def room(self, low, high, materials: dict[str, int]) -> None:
        """Add the sides of a box seen from inside: `materials` has keys -x +x -y +y -z +z; absent sides stay open."""
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        for side, material in materials.items():
            axis = "xyz".index(side[1])
            first, last = low.copy(), high.copy()
            first[axis] = last[axis] = low[axis] if side[0] == "-" else high[axis]
            self.rectangle(first, last, material, towards=(low + high) / 2)

    def prism(self, footprint, low: float, high: float, material: int, without=(), bottom: bool = False) -> None:
        """Add a solid seen from outside on a convex quadrilateral.

        `without` names sides that touch something else and are left out: "top", or i for the one between corners i and
        i + 1. The bottom is made on request only, since most solids stand on something.
        """
        footprint = np.asarray(footprint, dtype=float)
        owner = len(self.solids)
        first, second = footprint[1] - footprint[0], footprint[2] - footprint[1]
        turn = first[0] * second[1] - first[1] * second[0]
        self.solids.append(Solid(footprint if turn > 0 else footprint[::-1], low, high))
        middle = np.array([*footprint.mean(axis=0), (low + high) / 2])
        lower, upper = (np.column_stack([footprint, np.full(4, height)]) for height in (low, high))
        sides = {i: [lower[i], lower[(i + 1) % 4], upper[(i + 1) % 4], upper[i]] for i in range(4)}
        sides["top"] = upper
        if bottom:
            sides["bottom"] = lower
        for name, corners in sides.items():
            if name not in without:
                self.add(corners, material, away_from=middle, owner=owner)

    def box(self, low, high, material: int, without=(), bottom: bool = False) -> None:
        """Add an axis-aligned solid; sides 0 to 3 of `prism` are -y +x +y -x."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        self.prism([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z0, z1, material, without, bottom)

    def build(self, name: str, materials: list[bpy.types.Material], vertices: int) -> bpy.types.Object:
        """Link a mesh object of about this many vertices, in cells of about equal size, with the attribute `INTERIOR`.

        Few vertices are exceeded where every quadrilateral needs its four corners.
        """
        counts = _cells(np.array(self.quads), vertices)
        grids = [_grid(quad, *count) for quad, count in zip(self.quads, counts, strict=True)]
        offsets = np.cumsum([0] + [len(points) for points, _, _ in grids])
        points = np.concatenate([points for points, _, _ in grids])
        faces = np.concatenate([faces + offset for (_, faces, _), offset in zip(grids, offsets[:-1], strict=True)])
        interior = np.concatenate([inner for *_, inner in grids])
        owners = np.repeat(self.owners, np.diff(offsets))
        margin = _CONTACT * np.ptp(points, axis=0).max()
        for number, solid in enumerate(self.solids):
            interior &= ~(solid.holds(points, margin) & (owners != number))
        slots = np.repeat(self.materials, [len(faces) for _, faces, _ in grids])
        return _link(name, points, faces, slots, interior, materials)


def _cells(quads: np.ndarray, vertices: int) -> np.ndarray:
    """(n, 2) cells along both sides of each quadrilateral, for about this many vertices in all."""
    along = np.linalg.norm(quads[:, 1] - quads[:, 0], axis=1), np.linalg.norm(quads[:, 2] - quads[:, 3], axis=1)
    across = np.linalg.norm(quads[:, 2] - quads[:, 1], axis=1), np.linalg.norm(quads[:, 3] - quads[:, 0], axis=1)
    sides = np.stack([np.mean(along, axis=0), np.mean(across, axis=0)], axis=1)
    fine, coarse = sides.min() / (vertices + 1), sides.max()
    for _ in range(60):
        spacing = np.sqrt(fine * coarse)
        counts = np.maximum(1, np.rint(sides / spacing).astype(int))
        if (counts + 1).prod(axis=1).sum() > vertices:
            fine = spacing
        else:
            coarse = spacing
    return np.maximum(1, np.rint(sides / coarse).astype(int))


def _grid(quad: np.ndarray, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3), quadrilaterals (m, 4) and (n,) bool off the border, of one quadrilateral."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    u, v = u.reshape(-1, 1), v.reshape(-1, 1)
    points = (1 - v) * ((1 - u) * quad[0] + u * quad[1]) + v * ((1 - u) * quad[3] + u * quad[2])
    first = np.arange((columns + 1) * rows).reshape(rows, columns + 1)[:, :-1].ravel()
    faces = np.stack([first, first + 1, first + columns + 2, first + columns + 1], axis=1)
    inner = ((u > 0) & (u < 1) & (v > 0) & (v < 1)).ravel()
    return points, faces, inner


def _link(name, points, faces, slots, interior, materials) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 4, dtype=np.int32))
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", slots.astype(np.int32))
    mesh.update(calc_edges=True)
    mesh.attributes.new(INTERIOR, 'BOOLEAN', 'POINT').data.foreach_set("value", interior)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def interior_vertices(obj: bpy.types.Object) -> np.ndarray:
    """(n,) bool stored by `Model.build`."""
    values = np.empty(len(obj.data.vertices), bool)
    obj.data.attributes[INTERIOR].data.foreach_get("value", values)
    return values
