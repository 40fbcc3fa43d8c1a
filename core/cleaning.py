"""Bad geometry and impossible colors: left out or mended before anything is computed, and named once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .scene import Surfaces

#: Largest reflectance: a surface that keeps nothing would reflect for ever. Physical whites reach 0.98.
MAX_REFLECTANCE = 0.999

#: A triangle is degenerate when its area is below this part of the square of its longest side: float32 rays cannot hit
#: it, and its normal is rounding error.
DEGENERATE = 1e-7

#: Names listed in one warning before the rest is counted.
MAX_NAMES = 5

#: Triangles judged at a time.
BLOCK = 65536


@dataclass(frozen=True)
class CleanSurfaces:
    """Usable surfaces, the row (int32) each triangle had in the surfaces given, and what had to be said."""

    surfaces: Surfaces
    rows: np.ndarray
    warnings: list[str]


def named(objects: np.ndarray, surfaces: Surfaces) -> str:
    """The names of the objects that these triangles (k,) belong to, the first few of them."""
    names = sorted({surfaces.object_names[i] for i in np.unique(surfaces.objects[objects])})
    listed = ", ".join(f"'{name}'" for name in names[:MAX_NAMES])
    return listed + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")


def clean(surfaces: Surfaces) -> CleanSurfaces:
    """Leave out triangles that are not finite or have no area; clamp colors to what is possible.

    Returns
    -------
    CleanSurfaces
        May hold no triangle at all.
    """
    warnings = []
    finite, flat = _judge(np.asarray(surfaces.vertices, dtype=np.float64), surfaces.triangles)
    if not finite.all():
        warnings.append(
            f"{int((~finite).sum())} triangles with vertices that are not numbers were left out: "
            f"{named(~finite, surfaces)}. Delete those vertices"
        )
    if flat.any():
        warnings.append(
            f"{int(flat.sum())} triangles without area were left out: {named(flat, surfaces)}. "
            "Merge by Distance removes them"
        )
    usable = finite & ~flat
    # Nothing is copied where nothing is left out: a million triangles carry a hundred megabytes.
    rows = slice(None) if usable.all() else np.nonzero(usable)[0]
    palette, palette_rows = slice(None), None
    if surfaces.palette_rows is None:
        palette = rows
    else:
        palette_rows = surfaces.palette_rows[rows]
    reflectance, emission = surfaces.reflectance[palette], surfaces.emission[palette]
    transmittance = surfaces.transmittance[palette]
    vertices, triangles = compacted(surfaces.vertices, surfaces.triangles[rows])
    kept = replace(
        surfaces,
        vertices=vertices,
        triangles=triangles,
        materials=surfaces.materials[rows],
        objects=surfaces.objects[rows],
        two_sided=surfaces.two_sided[rows],
        textured=surfaces.textured[rows],
        palette_rows=palette_rows,
    )
    _report(
        warnings, kept, ~np.isfinite(reflectance) | (reflectance < 0) | (reflectance > 1), "reflectance outside 0 to 1"
    )
    _report(warnings, kept, ~np.isfinite(emission) | (emission < 0), "emission that is negative or not a number")
    kept = replace(
        kept,
        reflectance=clamped_reflectance(reflectance),
        emission=clamped_emission(emission),
        transmittance=np.clip(np.nan_to_num(transmittance), 0, 1),
    )
    return CleanSurfaces(kept, np.arange(len(usable), dtype=np.int32)[rows], warnings)


def _judge(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles (m,) are finite, and which of those have no area, in blocks of bounded memory."""
    finite, flat = np.empty(len(triangles), bool), np.empty(len(triangles), bool)
    for start in range(0, len(triangles), BLOCK):
        part = slice(start, start + BLOCK)
        a, b, c = (vertices[triangles[part, k]] for k in range(3))
        with np.errstate(invalid="ignore", over="ignore"):
            one, other = b - a, c - a
            finite[part] = np.isfinite(one + other).all(axis=1) & np.isfinite(a).all(axis=1)
            dots = [np.einsum("ij,ij->i", x, y) for x, y in ((one, one), (other, other), (one, other))]
            # Lagrange: the square of the doubled area. It loses half the digits, so what it calls thin is done again.
            double2 = dots[0] * dots[1] - dots[2] ** 2
            longest = np.maximum.reduce([dots[0], dots[1], dots[0] + dots[1] - 2 * dots[2]])
            flat[part] = ~(double2 > 1e-12 * longest**2)
            doubt = np.nonzero(flat[part])[0]
            double = np.linalg.norm(np.cross(one[doubt], other[doubt]), axis=1)
            flat[start + doubt] = ~(double > 2 * DEGENERATE * longest[doubt])
    return finite, finite & flat


def compacted(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Only the vertices that triangles use: the rest may be anywhere, or nowhere."""
    used = np.zeros(len(vertices), bool)
    used[triangles.ravel()] = True
    if used.all():
        return vertices, triangles
    return vertices[used], (np.cumsum(used) - 1).astype(np.int32)[triangles]


def clamped_reflectance(values: np.ndarray) -> np.ndarray:
    """Reflectance within [0, MAX_REFLECTANCE]; what is not a number reflects nothing."""
    if not values.size or (values.min() >= 0 and values.max() <= MAX_REFLECTANCE):
        return values
    return np.clip(np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0), 0, MAX_REFLECTANCE)


def clamped_emission(values: np.ndarray) -> np.ndarray:
    """Emission of at least 0; what is not a finite number emits nothing."""
    if not values.size or (values.min() >= 0 and values.max() < np.inf):
        return values
    return np.maximum(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0), 0)


def _report(warnings: list[str], surfaces: Surfaces, wrong: np.ndarray, what: str) -> None:
    """Warn about triangles whose row of the palette has a `wrong` (p, 3) color."""
    wrong = surfaces.wearing(wrong.any(axis=1))
    if wrong.any():
        warnings.append(f"A {what} was clamped: {named(wrong, surfaces)}. Check the material")
