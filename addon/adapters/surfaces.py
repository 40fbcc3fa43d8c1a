"""Meshes in their places as the triangles of `core.scene.Surfaces`.

A `Placement` is one mesh with its looks and all the places where it stands; places are transformed together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
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


def transform_points(positions: np.ndarray, matrices: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """(k, v, 3) float64 world positions of (v, 3) points under (k, 4, 4) matrices, in `out` where that is given."""
    with np.errstate(invalid="ignore", over="ignore"):  # broken vertices stay as they are; the core names them
        out = np.matmul(np.asarray(positions, dtype=np.float64), matrices[:, :3, :3].transpose(0, 2, 1), out=out)
        out += matrices[:, None, :3, 3]
    return out


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

    def finish(self, looks: np.ndarray, rows: np.ndarray) -> TexturedShader | None:
        """The shader of all triangles, None where no look varies."""
        if not self._looks:
            return None
        pools = []
        for number, parts in enumerate(self._parts):
            pools.append({key: np.concatenate([part[key] for part in parts]) for key in parts[0]})
            self._parts[number] = []  # nothing is held twice
        return TexturedShader(self._looks, pools, looks, rows)


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
    worn = [np.array([wear.row(look, i) for look in each.looks]) for i, each in enumerate(placements.values())]
    names = {name: row for row, name in enumerate(dict.fromkeys(_names(placements.values())))}
    is_varied = any(look.attributes for look in wear.looks)
    # A million triangles: the smallest type that holds the number of a look and of an object.
    columns = _Columns.empty(placements.values(), len(wear.looks), len(names), is_varied)
    vertex = triangle = 0
    for placement, looks in zip(placements.values(), worn, strict=True):
        count, arrays = len(placement.matrices), placement.arrays
        vertices = slice(vertex, vertex + count * len(arrays.positions))
        triangles = slice(triangle, triangle + count * len(arrays.triangle_corners))
        _fill(columns, vertices, triangles, placement, looks, pools, names)
        vertex, triangle = vertices.stop, triangles.stop
    palette = {
        name: table.astype(np.float32 if table.dtype == np.float64 else table.dtype)
        for name, table in wear.values().items()
    }
    two_sided = palette.pop("two_sided")[columns.materials]
    palette_rows, textured = columns.materials, np.zeros(triangle, dtype=bool)
    shader = None
    if is_varied:
        textured = columns.looks >= 0
        shader = pools.finish(columns.looks, columns.rows)
        palette_rows = _add_means(palette, shader, columns)
    return Surfaces(
        vertices=columns.vertices,
        triangles=columns.triangles,
        materials=columns.materials,
        objects=columns.objects,
        object_names=tuple(names),
        two_sided=two_sided,
        textured=textured,
        shader=shader,
        palette_rows=palette_rows,
        **palette,
    )


@dataclass
class _Columns:
    """Arrays to be filled placement after placement; `looks` and `rows`, of looks that vary, only where one does."""

    vertices: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray
    objects: np.ndarray
    looks: np.ndarray | None
    rows: np.ndarray | None

    @classmethod
    def empty(cls, placements: Iterable[Placement], looks: int, names: int, is_varied: bool) -> _Columns:
        """Room for all that the placements hold."""
        vertices, triangles = 0, 0
        for each in placements:
            vertices += len(each.matrices) * len(each.arrays.positions)
            triangles += len(each.matrices) * len(each.arrays.triangle_corners)
        return cls(
            vertices=np.empty((vertices, 3)),
            triangles=np.empty((triangles, 3), dtype=np.int32),
            materials=np.empty(triangles, dtype=np.min_scalar_type(looks)),
            objects=np.empty(triangles, dtype=np.min_scalar_type(names)),
            looks=np.empty(triangles, dtype=np.int32) if is_varied else None,
            rows=np.empty(triangles, dtype=np.int32) if is_varied else None,
        )


def _names(placements: Iterable[Placement]) -> Iterator[str]:
    for placement in placements:
        yield from placement.names


def _fill(columns: _Columns, vertices: slice, triangles: slice, placement: Placement, worn, pools: _Pools, names):
    """Fill the rows of one placement, instance after instance; `worn` are the rows of its looks."""
    arrays, looks = placement.arrays, placement.looks
    matrices = np.array(placement.matrices)
    count = len(matrices)
    transform_points(arrays.positions, matrices, out=columns.vertices[vertices].reshape(count, -1, 3))
    slots = np.minimum(arrays.face_materials, len(looks) - 1)[arrays.triangle_faces]
    columns.materials[triangles].reshape(count, -1)[:] = worn[slots]
    objects = np.array([names[name] for name in placement.names])
    columns.objects[triangles].reshape(count, -1)[:] = objects[:, None]
    corners = arrays.triangle_corners[:, [0, 2, 1]] if placement.mirrored else arrays.triangle_corners
    starts = vertices.start + np.arange(count, dtype=np.int32) * np.int32(len(arrays.positions))
    np.add(
        arrays.corner_vertices[corners], starts[:, None, None], out=columns.triangles[triangles].reshape(count, -1, 3)
    )
    if columns.looks is None:
        return
    rows = np.full(len(corners), -1, dtype=np.int32)
    programs = np.full(len(looks), -1, dtype=np.int32)
    for slot, look in enumerate(looks):
        if look.attributes:
            inside = np.flatnonzero(slots == slot)
            attributes = {key: placement.attributes[key][corners[inside]] for key in look.attributes}
            programs[slot], start = pools.add(look, attributes)
            rows[inside] = start + np.arange(len(inside))
    columns.looks[triangles].reshape(count, -1)[:] = programs[slots]
    columns.rows[triangles].reshape(count, -1)[:] = rows


def _add_means(palette: dict[str, np.ndarray], shader: TexturedShader, columns: _Columns) -> np.ndarray:
    """Append the mean colors of triangles that vary to the palette; returns the row of each triangle (m,) int32."""
    palette_rows = columns.materials.astype(np.int32)
    tables = {name: [table] for name, table in palette.items()}
    start = len(palette["transmittance"])
    for number, means in enumerate(shader.means()):
        wearing = np.flatnonzero(columns.looks == number)
        palette_rows[wearing] = start + columns.rows[wearing]
        for name, mean in zip(("reflectance", "emission", "transmittance"), means, strict=True):
            tables[name].append(mean.astype(np.float32))
        start += len(means[0])
    palette.update({name: np.concatenate(parts) for name, parts in tables.items()})
    return palette_rows
