"""Meshes in their places as the triangles of `core.scene.Surfaces`.

A `Placement` is one mesh with its looks and all the places where it stands; places are transformed together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...core.scene import Surfaces
from .materials import Look
from .mesh_arrays import AttributeKey, MeshArrays
from .surface_shader import TexturedShader


@dataclass
class Placement:
    """A mesh, its looks by material slot, the attributes at its corners that they ask for, and where it stands.

    All places of one are mirrored, or none.
    """

    arrays: MeshArrays
    looks: list[Look]
    attributes: Mapping[AttributeKey, np.ndarray]
    mirrored: bool
    names: list[str] = field(default_factory=list)
    matrices: list[np.ndarray] = field(default_factory=list)

    def add(self, name: str, matrix: np.ndarray) -> None:
        """One more place: the object's name and its (4, 4) matrix to the world."""
        self.names.append(name)
        self.matrices.append(matrix)


def transform_points(positions: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """(k, v, 3) float64 world positions of (v, 3) points under (k, 4, 4) matrices."""
    with np.errstate(invalid="ignore", over="ignore"):  # broken vertices stay as they are; the core names them
        return (
            np.asarray(positions, dtype=np.float64) @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
        )


def transform_normals(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(n, 3) float32 unit normals in the world of (n, 3) normals under a (4, 4) matrix.

    By the cofactors, which are the inverse transpose times the determinant and exist for flattened objects too. A
    mirrored object's normals keep pointing out of it, as Blender shows them.
    """
    axes = matrix[:3, :3]
    ahead, behind = [1, 2, 0], [2, 0, 1]
    low, high = axes[ahead], axes[behind]
    cofactors = low[:, ahead] * high[:, behind] - low[:, behind] * high[:, ahead]
    if axes[0] @ cofactors[0] < 0:  # the determinant, expanded along the first row
        cofactors = -cofactors
    size = np.abs(cofactors).max()
    if not (np.isfinite(size) and size > 0):
        return np.zeros(normals.shape, dtype=np.float32)
    cofactors = cofactors / size
    with np.errstate(invalid="ignore", over="ignore"):
        turned = normals @ cofactors.T.astype(np.float32)
        lengths = np.sqrt(np.einsum("ij,ij->i", turned, turned))
        return turned / np.where(lengths > 0, lengths, 1)[:, None]


class _Pools:
    """Gathers the attributes of all triangles of each look that varies."""

    def __init__(self) -> None:
        self._looks: list[Look] = []
        self._parts: list[list[Mapping[AttributeKey, np.ndarray]]] = []
        self._sizes: list[int] = []

    def add(self, look: Look, attributes: Mapping[AttributeKey, np.ndarray]) -> tuple[int, int]:
        """Number of the look, and the row of its pool at which these triangles start."""
        if look not in self._looks:
            self._looks.append(look)
            self._parts.append([])
            self._sizes.append(0)
        number = self._looks.index(look)
        start = self._sizes[number]
        self._parts[number].append(attributes)
        self._sizes[number] += len(next(iter(attributes.values())))
        return number, start

    def finish(self, looks: np.ndarray, rows: np.ndarray, columns: dict[str, np.ndarray]) -> TexturedShader | None:
        """The shader of all triangles; fills the mean colors of those that vary into `columns`."""
        if not self._looks:
            return None
        pools = [{key: np.concatenate([part[key] for part in parts]) for key in parts[0]} for parts in self._parts]
        shader = TexturedShader(self._looks, pools, looks, rows)
        for number, means in enumerate(shader.means()):
            wearing = looks == number
            for name, mean in zip(("reflectance", "emission", "transmittance"), means, strict=True):
                columns[name][wearing] = mean[rows[wearing]]
        return shader


class _Wear:
    """Looks as they are worn: one row for looks of equal values, and for one that varies on each placement."""

    def __init__(self) -> None:
        self._rows: dict[tuple, int] = {}
        self.looks: list[Look] = []

    def row(self, look: Look, placement: int) -> int:
        if look.attributes:
            key = (id(look), placement)
        else:
            reflectance, emission, transmittance = look.values
            key = (*reflectance, *emission, transmittance, look.two_sided)
        if key not in self._rows:
            self._rows[key] = len(self.looks)
            self.looks.append(look)
        return self._rows[key]

    def values(self) -> dict[str, np.ndarray]:
        """Columns of all rows; 0 where a look varies."""
        varying = np.zeros(3), np.zeros(3), 0.0
        values = [varying if look.attributes else look.values for look in self.looks]
        return {
            "reflectance": np.array([value[0] for value in values]).reshape(-1, 3),
            "emission": np.array([value[1] for value in values]).reshape(-1, 3),
            "transmittance": np.array([value[2] for value in values]),
            "two_sided": np.array([look.two_sided for look in self.looks], dtype=bool),
        }


def build_surfaces(placements: Mapping[tuple, Placement]) -> Surfaces:
    """All placements as one set of triangles.

    Parameters
    ----------
    placements : mapping of any key to Placement

    Returns
    -------
    Surfaces
        With zero triangles where there are no placements.
    """
    wear, pools = _Wear(), _Pools()
    names: dict[str, int] = {}
    parts = [_part(placement, i, wear, pools, names) for i, placement in enumerate(placements.values())]
    columns = {
        name: np.concatenate([part[i] for part in parts]) if parts else np.empty((0, *shape), dtype=dtype)
        for i, (name, (shape, dtype)) in enumerate(_COLUMNS.items())
    }
    offsets = np.cumsum([0, *(len(part[0]) for part in parts)])[:-1]
    counts = [len(part[1]) for part in parts]
    columns["triangles"] += np.repeat(offsets, counts)[:, None].astype(np.int32)
    for name, table in wear.values().items():
        # A million triangles: float32 halves what they take, and a color has no more digits than that.
        columns[name] = np.asarray(table).astype(np.float32 if table.dtype == np.float64 else table.dtype)[
            columns["materials"]
        ]
    looks, rows = columns.pop("looks"), columns.pop("rows")
    shader = pools.finish(looks, rows, columns)
    return Surfaces(object_names=tuple(names), textured=looks >= 0, shader=shader, **columns)


#: What `_part` gives: shape of a row and type.
_COLUMNS = {
    "vertices": ((3,), np.float64),
    "triangles": ((3,), np.int32),
    "materials": ((), np.int32),
    "objects": ((), np.int32),
    "looks": ((), np.int32),
    "rows": ((), np.int32),
}


def _part(placement: Placement, index: int, wear: _Wear, pools: _Pools, names: dict[str, int]) -> tuple:
    """Columns of one placement, instance after instance, with triangles that count vertices from 0."""
    arrays, looks = placement.arrays, placement.looks
    matrices = np.array(placement.matrices)
    count = len(matrices)
    slots = np.minimum(arrays.face_materials, len(looks) - 1)[arrays.triangle_faces]
    corners = arrays.triangle_corners[:, [0, 2, 1]] if placement.mirrored else arrays.triangle_corners
    rows = np.full(len(corners), -1, dtype=np.int32)
    programs = np.full(len(looks), -1, dtype=np.int32)
    for slot, look in enumerate(looks):
        if look.attributes:
            inside = np.flatnonzero(slots == slot)
            attributes = {key: placement.attributes[key][corners[inside]] for key in look.attributes}
            programs[slot], start = pools.add(look, attributes)
            rows[inside] = start + np.arange(len(inside))
    starts = np.arange(count, dtype=np.int32) * np.int32(len(arrays.positions))
    objects = np.array([names.setdefault(name, len(names)) for name in placement.names], dtype=np.int32)
    worn = np.array([wear.row(look, index) for look in looks], dtype=np.int32)
    return (
        transform_points(arrays.positions, matrices).reshape(-1, 3),
        (arrays.corner_vertices[corners].astype(np.int32) + starts[:, None, None]).reshape(-1, 3),
        np.tile(worn[slots], count),
        np.repeat(objects, len(corners)),
        np.tile(programs[slots], count),
        np.tile(rows, count),
    )
