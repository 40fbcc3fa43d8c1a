"""Colors of patches: means over what lies in them, textures included."""

from __future__ import annotations

import numpy as np

from ..cleaning import MAX_REFLECTANCE, clamped_emission, clamped_reflectance
from ..scene import Surfaces
from ..visibility.embree import OFFSET, Tracer
from .patches import POINTS, Patches

#: Places within each quarter of a cell at which a texture is read: 4 quarters of 4 make 16 readings a patch.
_PLACES = np.array([[1 / 3, 1 / 3], [2 / 3, 1 / 6], [1 / 6, 2 / 3], [1 / 6, 1 / 6]])


def patch_colors(
    patches: Patches,
    vertices: np.ndarray,
    triangles: np.ndarray,
    surfaces: Surfaces,
    source: np.ndarray,
    rows: np.ndarray | None,
    sampled: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and emission (P, 3) of what of each patch does not let light through.

    Parameters
    ----------
    vertices, triangles : (n, 3) float64, (m, 3) int
        The traced mesh, in the unit frame.
    surfaces : Surfaces
        The cleaned surfaces, in the unit frame.
    source : (m,) int
        A triangle of `surfaces` that each traced one stands for.
    rows : (t,) int or None
        Row of each triangle of `surfaces` in the surfaces that the shader knows; not needed where there is none.
    sampled : (m,) bool
        Traced triangles whose emission lights stand for: it must not count twice.
    """
    reflectance, emission = _constant(patches, triangles, vertices, surfaces, source)
    owners = source[patches.point_triangles[:, 0]]
    textured = np.nonzero(surfaces.textured[owners] & (patches.areas > 0))[0]
    if len(textured) and surfaces.shader is not None:
        read = _read(patches, textured, vertices, triangles, surfaces, source, rows)
        reflectance[textured], emission[textured] = read
    emission[sampled[patches.point_triangles].all(axis=1)] = 0
    # A ray passes a translucent triangle or stops at it; what it then sees is the part that does not let through.
    solid = np.maximum(1 - surfaces.transmittance[surfaces.palette_of(owners)], 1e-6)[:, None]
    return np.minimum(reflectance / solid, MAX_REFLECTANCE), emission / solid


def _constant(patches, triangles, vertices, surfaces, source):
    """Colors of the triangles themselves; of a cluster, their means by area."""
    owners = surfaces.palette_of(source[patches.point_triangles])
    reflectance, emission = surfaces.reflectance[owners].mean(axis=1), surfaces.emission[owners].mean(axis=1)
    small = np.nonzero(patches.divisions <= 1)[0]
    if len(small):
        corners = vertices[triangles[small]]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        patch = patches.first[small]
        total = np.bincount(patch, weights=areas, minlength=patches.count)
        many = total > 0
        worn = surfaces.palette_of(source[small])
        for out, values in ((reflectance, surfaces.reflectance), (emission, surfaces.emission)):
            for channel in range(3):
                weights = areas * values[worn, channel]
                sums = np.bincount(patch, weights=weights, minlength=patches.count)
                out[many, channel] = sums[many] / total[many]
    return reflectance, emission


def _read(patches, wanted, vertices, triangles, surfaces, source, rows):
    """Colors of textured patches: means over 16 readings each."""
    weights = patches.point_weights[wanted].astype(np.float64)
    # Four readings around each sample point: the quarter's middle moved within the quarter.
    spread = np.concatenate([1 - _PLACES.sum(axis=1, keepdims=True), _PLACES], axis=1) - 1 / 3
    k = patches.divisions[patches.point_triangles[wanted, 0]].astype(np.float64)
    step = spread[None, None] / (2 * k[:, None, None, None])
    weights = np.clip(weights[:, :, None] + step, 0, 1).reshape(-1, 3)
    weights /= weights.sum(axis=1, keepdims=True)
    traced = np.repeat(patches.point_triangles[wanted].ravel(), len(_PLACES))
    owners, weights = _on_original(weights, traced, vertices, triangles, surfaces, source)
    reflectance, emission, _ = surfaces.shader(rows[owners], weights)
    each = POINTS * len(_PLACES)
    return (
        clamped_reflectance(reflectance).reshape(-1, each, 3).mean(axis=1),
        clamped_emission(emission).reshape(-1, each, 3).mean(axis=1),
    )


def _on_original(weights, traced, vertices, triangles, surfaces, source):
    """The triangle of `surfaces` under each place on the traced mesh, and the barycentric weights there."""
    owners = source[traced]
    merged = ~np.isin(np.arange(len(surfaces.triangles)), source)
    if not (merged & surfaces.textured).any():
        return owners, weights
    # The traced triangle covers many of the artist's: a short ray finds the one below.
    textured = np.nonzero(surfaces.textured)[0]
    below = Tracer.build(surfaces.vertices.astype(np.float32), surfaces.triangles[textured])
    corners = vertices[triangles[traced]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    places = np.einsum("nw,nwi->ni", weights, corners)
    start = (places + 10 * OFFSET * normals).astype(np.float32)
    hits = below.closest(start, (-normals).astype(np.float32))
    near = (hits["primID"] >= 0) & (hits["tfar"] < 20 * OFFSET)
    owners = np.where(near, textured[np.maximum(hits["primID"], 0)], owners)
    u, v = hits["u"].astype(np.float64), hits["v"].astype(np.float64)
    found = np.stack([1 - u - v, u, v], axis=1)
    return owners, np.where(near[:, None], found, 1 / 3)
