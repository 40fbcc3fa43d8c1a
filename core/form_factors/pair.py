"""Form factor of a single pair of polygons, and configuration factor of a point and a polygon."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility import segments
from .clipped_quadrature import ClippedQuadrature
from .contour_integral import contour_rows
from .cropped import cropped_pair, cropped_point
from .disk import disk_rows
from .hemisphere import hemisphere_rows
from .hybrid import hybrid_rows
from .identities import repair
from .matrix import check_accuracy, find_method
from .point_to_polygon import point_to_polygon
from .quadrature import integrate_pair, sampled_pair, sampled_point
from .single_plane import single_plane_rows

#: Methods for single pairs, by name. The hemisphere needs an environment to cast its rays into; for a pair it is the
#: matrix of those few polygons.
PAIR_METHODS = (
    "point_to_polygon",
    "contour_integral",
    "hemisphere",
    "hemicube",
    "single_plane",
    "disk",
    "hybrid",
)
POINT_METHODS = ("point_to_polygon", "hemicube")

#: Methods whose rows serve a pair as they are, and without rays where there are no blockers.
ROWS = {"contour_integral": contour_rows, "disk": disk_rows, "hybrid": hybrid_rows}

#: What hides, by name, for point_to_polygon: rays, or exact clipping. `ROWS` take all that their matrices do.
VISIBILITIES = ("embree", "bsp")

#: Blockers up to which ``auto`` clips: some tenths of a second, and no blocker is missed however small.
CLIPPED_BLOCKERS = 32


def form_factor(
    polygon_a: np.ndarray,
    polygon_b: np.ndarray,
    blockers: Sequence[np.ndarray] = (),
    method: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    visibility: str = "auto",
) -> float:
    """Share of the power leaving the front of one polygon that reaches the front of another.

    Parameters
    ----------
    polygon_a, polygon_b : (k, 3) float
        Planar loops, counter-clockwise seen from their fronts.
    blockers : sequence of (k, 3) float
        Polygons that block from both sides.
    method : str
        ``auto`` or one of `PAIR_METHODS`.
    accuracy : float
        Error wanted, as an absolute number; where point_to_polygon casts rays, a standard error within
        `allowed_error`, which is less. ``hemicube`` keeps it as a part of the factor.
    seed : int
    visibility : str
        ``auto``, which clips exactly where blockers are few; ``embree`` for rays; ``bsp`` for exact clipping with
        point_to_polygon; contour_integral, disk and hybrid take all that they do in a matrix.

    Returns
    -------
    float

    Raises
    ------
    SettingsError
        If the method is unknown, does not take that visibility, or the accuracy is out of range.
    InvalidPolygonError
        If a polygon is malformed; the two polygons count as 0 and 1, blockers from 2.
    """
    check_accuracy(accuracy)
    # Without blockers the contour integral is exact; with a few, clipping is.
    chosen = "contour_integral" if method == "auto" and not len(blockers) else _choose(method, PAIR_METHODS)
    clipped = _clips(visibility, chosen, len(blockers))
    environment = Environment.from_polygons([polygon_a, polygon_b, *blockers])
    areas = environment.areas
    if areas[0] <= 0 or areas[1] <= 0:
        return 0.0
    if chosen in ROWS:
        if visibility == "auto":
            visibility = "embree" if len(environment) > 2 else "none"
        return float(ROWS[chosen](environment, visibility, accuracy, seed).matrix[0, 1])
    if chosen == "hemisphere":
        rows = hemisphere_rows(environment, accuracy, seed)
        return float(repair(rows.matrix, areas, False, rows.samples)[0, 1])
    if chosen == "single_plane":
        rows = single_plane_rows(environment, "zbuffer", accuracy, seed)
        return float(repair(rows.matrix, areas, False, rows.samples)[0, 1])
    # Sampling the smaller polygon needs fewer points, and reciprocity carries the result over.
    receiver, source = (0, 1) if areas[0] <= areas[1] else (1, 0)
    scale = areas[receiver] / areas[0]
    if chosen == "hemicube":
        factor, _ = cropped_pair(environment, receiver, source, accuracy, seed)
    elif clipped and len(environment) > 2:
        factors, _ = ClippedQuadrature(environment).pairs([receiver], [source], np.array([accuracy / scale]))
        factor = factors[0]
    elif len(environment) > 2:
        factor, _, _ = sampled_pair(environment, receiver, source, accuracy, seed)
    else:
        factor, _ = integrate_pair(environment, receiver, source, accuracy / scale)
    return float(min(max(factor * scale, 0.0), 1.0))


def configuration_factor(
    point: np.ndarray,
    normal: np.ndarray,
    polygon: np.ndarray,
    blockers: Sequence[np.ndarray] = (),
    method: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    visibility: str = "auto",
) -> float:
    """Share of the power leaving a differential area that reaches the front of a polygon.

    Parameters
    ----------
    point, normal : (3,) float
        Place and direction of the area; the normal need not have unit length.
    polygon : (k, 3) float
        Planar loop, counter-clockwise seen from its front.
    blockers : sequence of (k, 3) float
        Polygons that block from both sides.
    method : str
        ``auto`` or one of `POINT_METHODS`.
    accuracy : float
        Standard error wanted where rays are cast among blockers, by `allowed_error`; exact without, and with ``bsp``.
        ``hemicube`` keeps it as a part of the factor, with blockers or without.
    seed : int
    visibility : str
        ``embree`` for rays, ``bsp`` for exact clipping, or ``auto``, which clips where blockers are few.

    Returns
    -------
    float

    Raises
    ------
    SettingsError
        If the method is unknown, the accuracy out of range, or point or normal unusable.
    InvalidPolygonError
        If a polygon is malformed; the polygon counts as 0, blockers from 1.
    """
    check_accuracy(accuracy)
    chosen = _choose(method, POINT_METHODS)
    clipped = _clips(visibility, chosen, len(blockers))
    point, normal = (np.asarray(v, dtype=np.float64) for v in (point, normal))
    if point.shape != (3,) or normal.shape != (3,) or not np.isfinite([*point, *normal]).all() or not normal.any():
        raise SettingsError("Point and normal must be three finite numbers each, and the normal not zero")
    normal = normal / np.abs(normal).max()
    normal = normal / np.linalg.norm(normal)
    environment = Environment.from_polygons([polygon, *blockers])
    if chosen == "hemicube":
        return cropped_point(environment, point, normal, 0, accuracy, seed)[0]
    if clipped and len(environment) > 1:
        return ClippedQuadrature(environment).point(point, normal, 0)
    if len(environment) > 1:
        return sampled_point(environment, point, normal, 0, accuracy, seed)[0]
    return float(point_to_polygon(point[None], normal[None], environment.polygons[0])[0])


def _choose(method: str, known: tuple[str, ...]) -> str:
    chosen = known[0] if method == "auto" else method
    if chosen not in known:
        raise SettingsError(f"Unknown form-factor method {method!r}: choose auto, {', '.join(known)}")
    return chosen


def _clips(visibility: str, method: str, blockers: int) -> bool:
    """Whether a visibility means exact clipping: ``auto`` does where that is quick."""
    if visibility not in ("auto", *segments.VISIBILITIES):
        raise SettingsError(f"Unknown visibility {visibility!r}: choose auto, {', '.join(segments.VISIBILITIES)}")
    if method != "point_to_polygon":
        find_method(method, visibility, {})
        return False
    if visibility not in ("auto", *VISIBILITIES):
        raise SettingsError(
            f"Visibility {visibility!r} does not exist for point_to_polygon on a pair, as it casts rays or clips: "
            f"choose auto, {', '.join(VISIBILITIES)}"
        )
    return visibility == "bsp" or (visibility == "auto" and 0 < blockers <= CLIPPED_BLOCKERS)
