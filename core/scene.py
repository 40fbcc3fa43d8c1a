"""The scene as the bake sees it: arrays only, in meters, watts and scene-linear Rec.709 RGB.

`Surfaces` is everything that blocks, reflects and emits, as triangles. `ReceiverMesh` is a mesh whose corners want to
know their light. `Sky` is what a ray meets that meets nothing. Lamps live in `core.lights`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from .light_groups import LightGroups
from .lights import Light


class SurfaceShader(Protocol):
    """Colors at points of triangles, for surfaces whose color varies over a triangle."""

    def __call__(self, triangles: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reflectance (n, 3), emitted exitance (n, 3) in W/m2 and transmittance (n,) at n points.

        `triangles` (n,) are rows of `Surfaces.triangles`; `barycentric` (n, 3) are the weights of its three corners.
        """
        ...


@dataclass(frozen=True)
class Surfaces:
    """Everything that blocks, reflects or emits, as triangles.

    Parameters
    ----------
    vertices : (n, 3) float64
        Positions in meters. Rows that are not finite are tolerated when no triangle uses them.
    triangles : (m, 3) int32
        Rows of `vertices`, counter-clockwise seen from the front.
    materials : (m,) int
        Triangles with equal numbers have the same look; only those may be merged when they lie in one plane.
    objects : (m,) int
        Row of `object_names` that each triangle belongs to.
    object_names : sequence of str
        For warnings.
    reflectance : (p, 3) float
        Diffuse reflectance, 0 to 1, of each row of the palette; the mean over the triangle where it varies.
    emission : (p, 3) float
        Emitted radiant exitance in W/m2, pi times Blender's emission strength times color; on the front, and on the
        back too where `two_sided`. The mean over the triangle where it varies.
    transmittance : (p,) float
        Share of light that passes straight through, 0 (opaque) to 1 (invisible); 1 - alpha.
    two_sided : (m,) bool
        Whether the back reflects and emits as the front does. A one-sided back is black.
    textured : (m,) bool
        Where colors vary over the triangle, so that `shader` must be asked.
    shader : SurfaceShader or None
        Needed when any triangle is textured.
    palette_rows : (m,) int or None
        Row of the palette for each triangle, since a million of them wear a handful of looks; None where the palette
        has a row for each, in order.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray
    objects: np.ndarray
    object_names: Sequence[str]
    reflectance: np.ndarray
    emission: np.ndarray
    transmittance: np.ndarray
    two_sided: np.ndarray
    textured: np.ndarray
    shader: SurfaceShader | None = None
    palette_rows: np.ndarray | None = None

    def palette_of(self, triangles: np.ndarray) -> np.ndarray:
        """Rows of the palette, of the shape of `triangles`, which are rows of triangles."""
        return triangles if self.palette_rows is None else self.palette_rows[triangles]

    def wearing(self, chosen: np.ndarray) -> np.ndarray:
        """(m,) triangles whose row of the palette is among the `chosen` (p,) bool."""
        return chosen if self.palette_rows is None else chosen[self.palette_rows]


@dataclass(frozen=True)
class ReceiverMesh:
    """A mesh that wants to know its light: the artist's own topology, in world space.

    Parameters
    ----------
    name : str
        For warnings and the report.
    positions : (v, 3) float
        Vertices in meters, world space. May hold NaN: such vertices receive black and are reported. None once the
        receivers are placed, as the normals then are.
    corner_vertices : (c,) int32
        Vertex of each face corner.
    corner_normals : (c, 3) float32 or None
        Shading normals in world space, unit length: equal at all corners of a smooth vertex, the face's own where flat.
    face_offsets : (f + 1,) int32
        Corners of face i are ``face_offsets[i]:face_offsets[i + 1]``, in order around the face.
    face_materials : (f,) int32
        Row of the palette for each face.
    palette_reflectance, palette_emission : (p, 3) float
        Constant colors per palette row; emission is exitance in W/m2.
    corner_reflectance, corner_emission : (c, 3) float32 or None
        Colors per corner where any varies (textures, vertex colors); replaces the palette.
    vertex_normals : (v, 3) float32 or None
        Stands for `corner_normals` where all vertices are smooth: a quarter of the memory.
    flipped : bool
        Whether the object's matrix mirrors, so that corner order gives the inward normal.
    is_off_surface : bool
        Whether modifiers give the object another shape than this mesh has, so that its vertices may lie off what rays
        meet; they then take the light of the surface next to them.
    """

    name: str
    positions: np.ndarray | None
    corner_vertices: np.ndarray
    corner_normals: np.ndarray | None
    face_offsets: np.ndarray
    face_materials: np.ndarray
    palette_reflectance: np.ndarray
    palette_emission: np.ndarray
    corner_reflectance: np.ndarray | None = None
    corner_emission: np.ndarray | None = None
    vertex_normals: np.ndarray | None = None
    flipped: bool = False
    is_off_surface: bool = False

    def without_geometry(self) -> ReceiverMesh:
        """The same topology and colors without positions and normals, which are two thirds of a mesh."""
        return replace(self, positions=None, corner_normals=None, vertex_normals=None)

    def normals_at(self, corners: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(n, 3) float32 shading normals at corners, by default all."""
        if self.vertex_normals is None:
            return self.corner_normals[corners]
        return self.vertex_normals[self.corner_vertices[corners]]


@dataclass(frozen=True)
class Sky:
    """Radiance that arrives from outside, in W/(m2 sr), on an equal-area grid of directions.

    Rows are bands of equal height in z from -1 (nadir) to +1, columns are azimuth from 0 to 2 pi counted from +X
    towards +Y; every cell covers the same solid angle.

    Parameters
    ----------
    radiance : (rows, columns, 3) float
        Mean radiance of each cell; (1, 1, 3) for a uniform sky.
    """

    radiance: np.ndarray

    def cells(self, directions: np.ndarray) -> np.ndarray:
        """(n,) int32 cell, row by row, that each direction (n, 3) of any length leads to."""
        bands, columns = self.radiance.shape[:2]
        if bands * columns == 1:
            return np.zeros(len(directions), np.int32)
        height = directions[:, 2] / np.linalg.norm(directions, axis=1)
        band = np.clip((height + 1) * (bands / 2), 0, bands - 1).astype(np.int32)
        azimuth = np.arctan2(directions[:, 1], directions[:, 0]) * (columns / (2 * np.pi))
        return band * columns + (azimuth % columns).astype(np.int32) % columns

    def towards(self, directions: np.ndarray) -> np.ndarray:
        """(n, 3) radiance that arrives from directions (n, 3)."""
        return self.radiance.reshape(-1, 3)[self.cells(directions)]


@dataclass(frozen=True)
class Scene:
    """All that a bake needs. `warnings` are what the reader already had to say, merged and shown with the result;
    `groups`, where given, are lights whose light is wanted apart, each light in one of them."""

    surfaces: Surfaces
    receivers: Sequence[ReceiverMesh]
    lights: Sequence[Light] = ()
    sky: Sky | None = None
    warnings: Sequence[str] = field(default_factory=tuple)
    groups: LightGroups | None = None

    @property
    def sky_is_dark(self) -> bool:
        """Whether nothing arrives from outside."""
        return self.sky is None or not np.any(self.sky.radiance > 0)
