"""How the error of each sampling technique falls with its resolution, as the slope of a line through the logarithms.

The methods of `core.form_factors` choose their number of samples by the accuracy asked for. Here each technique stands
alone, at one resolution after the other: points in front of a unit square at distance 1 whose factors are known in
closed form, or, for rays that leave all over a patch, two such squares. An error is the RMS over `PLACES` points or
runs, so each is known to a tenth and a slope to some hundredths. A few seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from radiosity import core
from radiosity.core.form_factors.disk import disk_factor
from radiosity.core.form_factors.hemicube import Hemicube
from radiosity.core.form_factors.hemisphere import REPETITIONS, RowCaster
from radiosity.core.form_factors.point_to_point import point_to_vertices
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.form_factors.single_plane import SinglePlane
from radiosity.core.visibility.zbuffer import Loops

SQUARE = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]], dtype=float)
UP = np.array([0.0, 0.0, 1.0])
PLACES = 40

#: Share of the light near the horizon that the single plane does not see: the square is above it.
LOST = 0.02

COLUMNS = ("technique", "unit", "resolution", "rms_error", "slope", "expected")


@dataclass(frozen=True)
class Technique:
    """Estimates (PLACES,) less the truth at a resolution, and the slope that theory gives."""

    method: str
    label: str
    unit: str
    resolutions: tuple[int, ...]
    errors: Callable[[int], np.ndarray]
    expected: float


def _points() -> np.ndarray:
    """Places below the square."""
    return np.random.default_rng(7).random((PLACES, 3)) * (1, 1, 0)


def _exact(points: np.ndarray) -> np.ndarray:
    return point_to_polygon(points, np.tile(UP, (len(points), 1)), SQUARE)


def _turned_frames(turned: bool) -> np.ndarray:
    """(PLACES, 3, 3) frames about the normal, turned at random or along the square's edges."""
    angles = np.random.default_rng(8).uniform(0, 2 * np.pi, PLACES) * turned
    zero, one = np.zeros(PLACES), np.ones(PLACES)
    cosines, sines = np.cos(angles), np.sin(angles)
    return np.stack([cosines, sines, zero, -sines, cosines, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)


def _item_errors(camera, turned: bool) -> np.ndarray:
    points = _points()
    items = camera.items(points, _turned_frames(turned), Loops.of(core.Environment.from_polygons([SQUARE])))
    return (items == 0) @ camera.deltas - _exact(points)


def _ray_errors(rays: int, sampling: str) -> np.ndarray:
    polygons = [SQUARE, (SQUARE - (0, 0, 1))[::-1]]
    exact = core.form_factor(*polygons)
    caster = RowCaster(core.Environment.from_polygons(polygons), 1, sampling)
    shares = [caster.rows(np.array([0]), rays // REPETITIONS, (seed, 0))[0] for seed in range(PLACES)]
    return np.array(shares)[:, 0, 1] - exact


def _disk_errors(samples: int) -> np.ndarray:
    points = _points()
    return np.array([disk_factor(point, UP, SQUARE, samples) for point in points]) - _exact(points)


def _vertex_errors(cells: int) -> np.ndarray:
    points = _points()
    return point_to_vertices(points, np.tile(UP, (PLACES, 1)), SQUARE, cells) - _exact(points)


PIXELS, RAYS = (16, 32, 64, 128), (256, 1024, 4096, 16384)

#: What is measured. A hemicube along the edges gains or loses whole rows of pixels, a turned one single pixels; low
#: discrepancy lies between 1/2 and 5/8, the limit for edges of patches in four dimensions.
TECHNIQUES = (
    Technique("hemicube", "along edges", "pixels a side", PIXELS, lambda n: _item_errors(Hemicube.of(n), False), -1.0),
    Technique("hemicube", "turned", "pixels a side", PIXELS, lambda n: _item_errors(Hemicube.of(n), True), -1.5),
    Technique(
        "single_plane", "turned", "proxels a side", PIXELS, lambda n: _item_errors(SinglePlane.of(LOST, n), True), -1.5
    ),
    Technique("hemisphere", "low discrepancy", "rays", RAYS, lambda n: _ray_errors(n, "low_discrepancy"), -0.625),
    Technique("hemisphere", "random", "rays", RAYS, lambda n: _ray_errors(n, "random"), -0.5),
    Technique("disk", "uniform", "samples", (16, 64, 256, 1024), _disk_errors, -1.0),
    Technique("point_to_point", "vertices", "cells a side", (4, 8, 16, 32), _vertex_errors, -2.0),
)


def measure(methods: list[str]) -> list[dict]:
    """Lines of all techniques of some methods; all of a technique have its slope."""
    lines = []
    for technique in TECHNIQUES:
        if technique.method not in methods:
            continue
        found = [float(np.sqrt(np.mean(np.square(technique.errors(n))))) for n in technique.resolutions]
        slope = float(np.polyfit(np.log(technique.resolutions), np.log(found), 1)[0])
        lines += [
            {
                "method": technique.method,
                "technique": f"{technique.method}, {technique.label}",
                "unit": technique.unit,
                "resolution": resolution,
                "rms_error": error,
                "slope": slope,
                "expected": technique.expected,
            }
            for resolution, error in zip(technique.resolutions, found, strict=True)
        ]
    return lines
