"""Which meshes can be divided, how long their edges are in the scene, and what dividing them would make.

Lengths are those in the world: the object's scale counts. The base mesh is divided, under its modifiers. What cannot be
carried over (shape keys, multires sculpts, skins) is refused by name before anything is touched.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.discretization.subdivision import (
    PolygonMesh,
    fitting_edge_length,
    predict_all,
    proposed_edge_length,
    subdivide,
)
from ...core.errors import RadiosityError
from .mesh_arrays import read_mesh
from .mesh_rewriting import rewrite_mesh

# So many vertices are counted exactly, for a message; that takes a fraction of a second.
_COUNTED_VERTICES = 100_000


class SubdivisionError(RadiosityError):
    """A mesh cannot be divided, or not so finely; the text names it and the remedy."""


@dataclass(frozen=True)
class SubdivisionTarget:
    """A mesh to divide: `name` of the object that shows it, and its faces with positions in the world."""

    name: str
    mesh: bpy.types.Mesh
    polygons: PolygonMesh


def subdivision_targets(objects: Iterable[bpy.types.Object]) -> list[SubdivisionTarget]:
    """The meshes of the objects, each once.

    Raises
    ------
    SubdivisionError
        If there is no mesh with faces among them, or one of them cannot be divided.
    """
    chosen = [obj for obj in objects if obj.type == 'MESH']
    if not chosen:
        raise SubdivisionError("No mesh is selected: select the objects to divide")
    names = {obj.name for obj in chosen}
    targets, seen = [], set()
    for obj in chosen:
        mesh = obj.data
        if mesh in seen:
            continue
        seen.add(mesh)
        if len(mesh.polygons):
            _refuse_unfit(obj, names)
            targets.append(SubdivisionTarget(obj.name, mesh, _polygon_mesh(obj)))
    if not targets:
        raise SubdivisionError(f'"{chosen[0].name}" has no faces: select meshes with faces to divide')
    return targets


def _refuse_unfit(obj: bpy.types.Object, chosen: set[str]) -> None:
    mesh = obj.data
    if not mesh.is_editable:
        raise SubdivisionError(f'The mesh of "{obj.name}" is linked from another file: make it local to divide it')
    if mesh.is_editmode:
        raise SubdivisionError(f'"{obj.name}" is in Edit Mode: leave it to divide the mesh')
    if mesh.shape_keys is not None:
        raise SubdivisionError(f'"{obj.name}" has shape keys: apply or remove them to divide it')
    if any(modifier.type == 'MULTIRES' for modifier in obj.modifiers):
        raise SubdivisionError(f'"{obj.name}" has a Multires modifier: apply or remove it to divide the mesh')
    if len(mesh.skin_vertices):
        raise SubdivisionError(f'"{obj.name}" has skin data: apply its Skin modifier or clear the data to divide it')
    users = [other for other in bpy.data.objects if other.data == mesh and other != obj]
    for other in users:
        if other.name not in chosen:
            raise SubdivisionError(
                f'"{other.name}" shares the mesh of "{obj.name}": select both, or make "{obj.name}" single-user'
            )
        if not np.allclose(_metric(other), _metric(obj), rtol=1e-4, atol=1e-4 * np.abs(_metric(obj)).max()):
            raise SubdivisionError(
                f'"{other.name}" and "{obj.name}" share a mesh at different scales: make one of them single-user'
            )


def _linear(obj: bpy.types.Object) -> np.ndarray:
    return np.array(obj.matrix_world.to_3x3(), dtype=np.float64)


def _metric(obj: bpy.types.Object) -> np.ndarray:
    """(3, 3) what turns differences of local positions into squared lengths: the same for turned and moved objects."""
    linear = _linear(obj)
    return linear.T @ linear


def _polygon_mesh(obj: bpy.types.Object) -> PolygonMesh:
    mesh = obj.data
    arrays = read_mesh(mesh)
    edges = np.empty(2 * len(mesh.edges), dtype=np.int32)
    mesh.edges.foreach_get("vertices", edges)
    corner_edges = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("edge_index", corner_edges)
    return PolygonMesh(
        # Positions only matter through their differences: the place of the object would cost digits.
        positions=arrays.positions.astype(np.float64) @ _linear(obj).T,
        edges=edges.reshape(-1, 2),
        face_offsets=arrays.face_offsets,
        corner_vertices=arrays.corner_vertices,
        corner_edges=corner_edges,
        triangles=arrays.triangle_corners,
        triangle_faces=arrays.triangle_faces,
    )


def proposed_length(targets: Sequence[SubdivisionTarget]) -> float:
    """A maximum edge length that gives the meshes about 20,000 vertices in all; 0 when they have no area."""
    return proposed_edge_length([target.polygons for target in targets])


def predicted_counts(targets: Sequence[SubdivisionTarget], length: float, limit: int) -> tuple[int, int] | None:
    """Vertices and faces that the meshes would have together, exactly; None when the vertices pass the limit."""
    return predict_all([target.polygons for target in targets], length, limit)


def subdivide_targets(targets: Sequence[SubdivisionTarget], length: float, limit: int) -> tuple[int, int, int]:
    """Divide the meshes until no edge is longer than `length` in the world.

    Returns
    -------
    meshes, vertices, faces : int
        How many meshes were changed, and what all of them have now together.

    Raises
    ------
    SubdivisionError
        If they would get more than `limit` vertices; nothing is changed then.
    """
    polygons = [target.polygons for target in targets]
    counts = predict_all(polygons, length, limit)
    if counts is None:
        raise _too_many(polygons, length, limit)
    # All are divided before the first is written: what can fail, fails while nothing has changed.
    results = [(target.mesh, subdivide(target.polygons, length)) for target in targets]
    changed = [(mesh, result) for mesh, result in results if result is not None]
    for mesh, result in changed:
        rewrite_mesh(mesh, result)
    return (len(changed), *counts)


def _too_many(polygons: Sequence[PolygonMesh], length: float, limit: int) -> SubdivisionError:
    fitting = fitting_edge_length(polygons, limit, start=length)
    if not np.isfinite(fitting):
        existing = sum(len(mesh.positions) for mesh in polygons)
        return SubdivisionError(
            f"The selected meshes have {existing:,} vertices already, above the limit of {limit:,}: raise the limit or"
            " select fewer meshes"
        )
    enough = max(limit, _COUNTED_VERTICES)
    counts = predict_all(polygons, length, enough)
    if counts is None:
        # Too many to count: with such short edges, vertices grow with the inverse square of the length.
        base = fitting_edge_length(polygons, enough, start=length)
        vertices = float(f"{predict_all(polygons, base)[0] * (base / length) ** 2:.1e}")
        wanted = f"about {max(vertices, enough + 1.0):,.0f}"
    else:
        wanted = f"{counts[0]:,}"
    return SubdivisionError(
        f"Edges of at most {length:g} m would make {wanted} vertices, above the limit of {limit:,}: use {fitting:g} m"
        f" ({predict_all(polygons, fitting)[0]:,} vertices) or raise the limit"
    )
