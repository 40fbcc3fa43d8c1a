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


def is_mirrored(matrices: np.ndarray) -> np.ndarray:
    """(k,) whether (k, 4, 4) matrices turn the front of a face to its back."""
    return np.linalg.det(matrices[:, :3, :3]) < 0


def transform_normals(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(n, 3) float32 unit normals in the world of (n, 3) normals under a (4, 4) matrix.

    By the cofactors, which are the inverse transpose times the determinant and exist for flattened objects too. A
    mirrored object's normals keep pointing out of it, as Blender shows them.
    """
    x, y, z = matrix[:3, :3].T
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    if is_mirrored(matrix[None])[0]:
        cofactors = -cofactors
    with np.errstate(invalid="ignore", over="ignore"):
        turned = np.asarray(normals, dtype=np.float64) @ cofactors.T
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        return (turned / np.where(lengths > 0, lengths, 1)).astype(np.float32)


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


class _LookNumbers:
    """Numbers of looks: equal for looks of equal values, or of one varying look on one placement."""

    def __init__(self) -> None:
        self._known: dict[tuple, int] = {}

    def number(self, look: Look, placement: int) -> int:
        if look.attributes:
            key = (id(look), placement)
        else:
            reflectance, emission, transmittance = look.values
            key = (*reflectance, *emission, transmittance, look.two_sided)
        return self._known.setdefault(key, len(self._known))


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
    numbers = _LookNumbers()
    pools = _Pools()
    names: dict[str, int] = {}
    parts = [_part(placement, i, numbers, pools, names) for i, placement in enumerate(placements.values())]
    columns = {name: _join([part[name] for part in parts], *_COLUMNS[name]) for name in _COLUMNS}
    offsets = np.cumsum([0, *(len(part["vertices"]) for part in parts)])[:-1]
    counts = [len(part["triangles"]) for part in parts]
    columns["triangles"] = (columns["triangles"] + np.repeat(offsets, counts)[:, None]).astype(np.int32)
    looks, rows = columns.pop("looks"), columns.pop("rows")
    shader = pools.finish(looks, rows, columns)
    return Surfaces(object_names=tuple(names), textured=looks >= 0, shader=shader, **columns)


#: Columns of each part: shape of a row and type.
_COLUMNS = {
    "vertices": ((3,), np.float64),
    "triangles": ((3,), np.int64),
    "materials": ((), np.int32),
    "objects": ((), np.int32),
    "reflectance": ((3,), np.float64),
    "emission": ((3,), np.float64),
    "transmittance": ((), np.float64),
    "two_sided": ((), bool),
    "looks": ((), np.int32),
    "rows": ((), np.int32),
}


def _join(arrays, shape, dtype) -> np.ndarray:
    return np.concatenate(arrays).astype(dtype, copy=False) if arrays else np.empty((0, *shape), dtype=dtype)


def _part(placement: Placement, index: int, numbers: _LookNumbers, pools: _Pools, names: dict[str, int]) -> dict:
    """Columns of one placement, instance after instance."""
    arrays, looks = placement.arrays, placement.looks
    matrices = np.array(placement.matrices)
    count = len(matrices)
    slots = np.clip(arrays.face_materials, 0, len(looks) - 1)[arrays.triangle_faces]
    corners = arrays.triangle_corners[:, [0, 2, 1]] if placement.mirrored else arrays.triangle_corners
    rows = np.full(len(corners), -1, dtype=np.int32)
    values = [(np.zeros(3), np.zeros(3), 0.0) if look.attributes else look.values for look in looks]
    programs = np.full(len(looks), -1, dtype=np.int32)
    for slot, look in enumerate(looks):
        if look.attributes:
            inside = np.flatnonzero(slots == slot)
            attributes = {key: placement.attributes[key][corners[inside]] for key in look.attributes}
            programs[slot], start = pools.add(look, attributes)
            rows[inside] = start + np.arange(len(inside))
    triangles = np.broadcast_to(arrays.corner_vertices[corners].astype(np.int64), (count, len(corners), 3)).copy()
    triangles += (np.arange(count) * len(arrays.positions))[:, None, None]

    def tile(per_triangle):
        return np.broadcast_to(per_triangle, (count, *per_triangle.shape)).reshape(-1, *per_triangle.shape[1:])

    return {
        "vertices": transform_points(arrays.positions, matrices).reshape(-1, 3),
        "triangles": triangles.reshape(-1, 3),
        "materials": tile(np.array([numbers.number(look, index) for look in looks])[slots]),
        "objects": np.repeat([names.setdefault(name, len(names)) for name in placement.names], len(corners)),
        "reflectance": tile(np.array([value[0] for value in values])[slots]),
        "emission": tile(np.array([value[1] for value in values])[slots]),
        "transmittance": tile(np.array([value[2] for value in values])[slots]),
        "two_sided": tile(np.array([look.two_sided for look in looks])[slots]),
        "looks": tile(programs[slots]),
        "rows": tile(rows),
    }
