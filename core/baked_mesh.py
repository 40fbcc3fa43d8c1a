"""Light at the corners of one mesh, ready to be written in any of the forms a bake can store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .cleaning import clamped_emission, clamped_reflectance
from .light_groups import BANDS, LightGroups
from .scene import ReceiverMesh


@dataclass(frozen=True)
class BakedMesh:
    """Light at one `ReceiverMesh`.

    Parameters
    ----------
    mesh : ReceiverMesh
        Only its topology and colors are used.
    vertices : int
        How many vertices it has.
    corner_receivers : (c,) int32
        Row of the arrays below for each corner, -1 where there is none.
    direct, indirect : (r, 3) float32
        Irradiance in W/m2 of all receivers of the bake, shared by its meshes.
    buried : (r,) bool
        Receivers inside other solids, whose light was filled in from neighbors.
    emits : bool
        Whether what the mesh itself emits belongs to this light, which may be that of one light group.
    """

    mesh: ReceiverMesh
    vertices: int
    corner_receivers: np.ndarray
    direct: np.ndarray
    indirect: np.ndarray
    buried: np.ndarray
    emits: bool = True

    @property
    def name(self) -> str:
        """Of the mesh, for reports."""
        return self.mesh.name

    @property
    def buried_corners(self) -> np.ndarray:
        """(c,) bool: corners whose light was filled in from neighbors."""
        return self.buried[self.corner_receivers] & (self.corner_receivers >= 0)

    def corner_colors(self, bake_type: str) -> np.ndarray:
        """(c, 3) float32 per face corner, in W/(m2 sr).

        Exitance over pi for ``combined`` and ``emission``, irradiance over pi for ``lighting``, ``direct`` and
        ``indirect``. Black where a corner has no receiver.
        """
        if bake_type == "emission":
            return (self._emission() / np.pi).astype(np.float32)
        light = {"direct": self.direct, "indirect": self.indirect}.get(bake_type)
        receivers = self.corner_receivers
        if light is None:
            arriving = self.direct[receivers]
            arriving += self.indirect[receivers]
        else:
            arriving = light[receivers]
        arriving *= np.float32(1 / np.pi)
        if bake_type == "combined":
            arriving *= self._reflectance()
            arriving += self._emission() / np.float32(np.pi)
        arriving[receivers < 0] = 0
        return arriving

    def vertex_colors(self, bake_type: str) -> np.ndarray:
        """(v, 3) float32 per vertex: the mean of its corners that are not buried, or of all where all are."""
        colors = self.corner_colors(bake_type)
        vertices, count = self.mesh.corner_vertices, self.vertices
        weight = np.where(self.buried_corners, 1e-9, 1.0) * (self.corner_receivers >= 0)
        total = np.bincount(vertices, weights=weight, minlength=count)
        out = np.empty((count, 3), np.float32)
        for channel in range(3):
            sums = np.bincount(vertices, weights=weight * colors[:, channel], minlength=count)
            out[:, channel] = sums / np.maximum(total, 1e-30)
        return out

    def _faces(self) -> np.ndarray:
        return np.repeat(self.mesh.face_materials, np.diff(self.mesh.face_offsets))

    def _reflectance(self) -> np.ndarray:
        if self.mesh.corner_reflectance is not None:
            return clamped_reflectance(self.mesh.corner_reflectance)
        palette = clamped_reflectance(self.mesh.palette_reflectance).astype(np.float32)
        return palette[0] if len(palette) == 1 else palette[self._faces()]

    def _emission(self) -> np.ndarray:
        dark = np.zeros((len(self.mesh.corner_vertices), 3), np.float32)
        if not self.emits:
            return dark
        if self.mesh.corner_emission is not None:
            return clamped_emission(self.mesh.corner_emission)
        palette = clamped_emission(self.mesh.palette_emission).astype(np.float32)
        if not palette.any():
            return dark
        return palette[self._faces()]


def baked_meshes(
    meshes: Sequence[tuple[ReceiverMesh, int]],
    corner_receivers: Sequence[np.ndarray],
    light: np.ndarray,
    buried: np.ndarray,
    groups: LightGroups | None,
) -> tuple[list[BakedMesh], dict[str, list[BakedMesh]]]:
    """All meshes with the whole light, and once more with that of each light group, by its name.

    Parameters
    ----------
    meshes : sequence of (ReceiverMesh, int)
        Each with the number of its vertices.
    corner_receivers : sequence of (c,) int32
        Row of the receivers for each corner of each mesh.
    light : (r, 2 c) float32
        Of all receivers, as `light_groups.joined` makes it.
    buried : (r,) bool
    groups : LightGroups or None
    """
    parts = [light[:, at : at + 2 * BANDS] for at in range(0, light.shape[1], 2 * BANDS)]

    def with_light(part: np.ndarray, emit: Sequence[bool]) -> list[BakedMesh]:
        return [
            BakedMesh(mesh, vertices, corners, part[:, :BANDS], part[:, BANDS:], buried, bool(emits))
            for (mesh, vertices), corners, emits in zip(meshes, corner_receivers, emit, strict=True)
        ]

    everything = with_light(parts[0], [True] * len(meshes))
    if groups is None:
        return everything, {}
    apart = (with_light(part, groups.receivers == row) for row, part in enumerate(parts[1:]))
    return everything, dict(zip(groups.names, apart, strict=True))


def receiver_warnings(meshes: Sequence[BakedMesh]) -> list[str]:
    """What could not be lit, in one line."""
    broken = [mesh.name for mesh in meshes if np.any(mesh.corner_receivers < 0)]
    if not broken:
        return []
    return [f"Vertices without a position or normal stay black: {', '.join(repr(name) for name in broken)}"]
