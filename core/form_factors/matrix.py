"""The form-factor matrix of an environment, by any method."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..environment import Environment
from ..errors import SceneTooLargeError, SettingsError
from .aimed_rays import FEW_PATCHES, hemisphere_factors
from .automatic import automatic_rows
from .clipped_quadrature import clipped_rows
from .contour_integral import contour_rows
from .disk import disk_points, disk_rows
from .hemicube import hemicube_points, hemicube_rows
from .hemisphere import SampledRows, hemisphere_points
from .hybrid import hybrid_points, hybrid_rows
from .identities import closure_error, reciprocity_error, repair
from .point_rows import PointRows
from .point_to_point import point_to_point_points, point_to_point_rows
from .quadrature import quadrature_rows
from .single_plane import single_plane_points, single_plane_rows
from .visible_polygons import visible_polygon_points

#: Matrix entries beyond which a matrix is refused: 8 GiB each for the factors and the copy that repairs them.
LARGEST_MATRIX = 2**30

#: Share of a patch's power that may escape, per unit of accuracy asked for, while the scene still counts as closed. A
#: tenth, beside what a method loses at seams by itself: an opening that small changes no factor by the accuracy.
CLOSED_SHARE = 0.1


@dataclass(frozen=True)
class Method:
    """A way to fill a matrix.

    ``compute(environment, visibility, accuracy, seed, threads, **options)`` returns `SampledRows`, and
    ``at_points(environment, visibility, accuracy, seed, threads)`` what gives rows of single points (`point_rows`);
    `visibilities` are the names it accepts, the first being what ``auto`` takes; `options` are the names of its own
    options; `refusal` says why it accepts no other visibility, and `accuracy` is what it takes for few patches where
    none is given.
    """

    compute: Callable[..., SampledRows]
    at_points: Callable[..., PointRows]
    visibilities: tuple[str, ...]
    options: tuple[str, ...] = ()
    refusal: str = "there is none of that name"
    accuracy: float = 1e-3


def _point_to_polygon(environment, visibility, accuracy, seed, threads):
    compute = clipped_rows if visibility == "bsp" else quadrature_rows
    return compute(environment, visibility, accuracy, seed, threads)


#: Visibilities that tell whether two points see each other, which any kernel of points takes. Point to polygon clips
#: exactly where the visibility is ``bsp``, instead of testing segments.
SEGMENTS = ("embree", "zbuffer", "bsp", "silhouettes", "brute_force")

#: Why methods refuse a visibility.
FIRST_HIT = "it counts what each of its rays meets first, which only embree tells"
ITEM_BUFFER = "what its pixels show is an item buffer, which only the z-buffer is"
BOTH_KINDS = "it parts what is visible from what is hidden; where nothing hides, contour_integral is the same"

#: Accuracy of the hemisphere for few patches where none is given. Rough work allows a fiftieth of a factor, or 1e-3 of
#: small ones: some three of the standard errors that this asks for.
SAMPLED = 7e-3

#: Methods by name; a new technique adds its entry here.
METHODS: dict[str, Method] = {
    "hemisphere": Method(hemisphere_factors, hemisphere_points, ("embree",), ("sampling",), FIRST_HIT, SAMPLED),
    "hemicube": Method(hemicube_rows, hemicube_points, ("zbuffer",), ("resolution",), ITEM_BUFFER),
    "single_plane": Method(single_plane_rows, single_plane_points, ("zbuffer",), ("resolution", "lost"), ITEM_BUFFER),
    "point_to_polygon": Method(_point_to_polygon, visible_polygon_points, (*SEGMENTS, "none")),
    "point_to_point": Method(
        point_to_point_rows,
        point_to_point_points,
        ("silhouettes", *(name for name in SEGMENTS if name != "silhouettes"), "none"),
        ("cells",),
    ),
    "disk": Method(disk_rows, disk_points, (*SEGMENTS, "none"), ("sampling", "samples")),
    "hybrid": Method(hybrid_rows, hybrid_points, SEGMENTS, ("detection",), BOTH_KINDS),
    "contour_integral": Method(contour_rows, visible_polygon_points, (*SEGMENTS, "none"), ("fast",)),
}

#: What ``auto`` takes where a visibility or an option is named, which leaves no choice for each pair.
DEFAULT_METHOD = "hemisphere"


@dataclass(frozen=True)
class FormFactors:
    """Form factors of an environment.

    Attributes
    ----------
    matrix : (n, n) float64
        Share of the power leaving the row's patch that reaches the column's.
    escaped : (n,) float64
        Share that reaches no patch, as measured; 0 in closed scenes.
    closed : bool
        Whether the scene was found closed, so that rows were made to sum to 1.
    seconds : float
    rays : int
    method_counts : dict of str to int
        Rows computed by each method; under ``auto`` pairs, but rows for the hemisphere.
    closure_error : float
        Largest ``|row sum + escaped - 1|`` of `matrix`.
    reciprocity_error : float
        Largest ``|A_i F_ij - A_j F_ji|`` of `matrix` over the smaller area.
    estimated_error : float
        Error of the worst factor as computed, before the repair, which lowers it: standard error where sampled.
    raw_closure_error, raw_reciprocity_error : float
        The same two before the repair: how far the method alone was off.
    """

    matrix: np.ndarray
    escaped: np.ndarray
    closed: bool
    seconds: float
    rays: int
    method_counts: dict[str, int]
    closure_error: float
    reciprocity_error: float
    estimated_error: float
    raw_closure_error: float
    raw_reciprocity_error: float


def find_method(name: str, visibility: str, options: dict) -> tuple[str, Method, str]:
    """Name, method and visibility meant by a choice of names.

    Raises
    ------
    SettingsError
        If a name is unknown, or the method does not take that visibility or option.
    """
    chosen = DEFAULT_METHOD if name == "auto" else name
    if chosen not in METHODS:
        raise SettingsError(f"Unknown form-factor method {name!r}: choose auto, {', '.join(METHODS)}")
    method = METHODS[chosen]
    if visibility != "auto" and visibility not in method.visibilities:
        raise SettingsError(
            f"Visibility {visibility!r} does not exist for {chosen}, as {method.refusal}: "
            f"choose auto, {', '.join(method.visibilities)}"
        )
    for option in options:
        if option not in method.options:
            known = f": choose {', '.join(method.options)}" if method.options else ", it has none"
            raise SettingsError(f"Unknown option {option!r} of method {chosen}{known}")
    return chosen, method, method.visibilities[0] if visibility == "auto" else visibility


def check_accuracy(accuracy: float | None) -> None:
    """Raise SettingsError unless `accuracy` lies above 0 and below 1, or is left to the method."""
    if accuracy is not None and not 0 < accuracy < 1:
        raise SettingsError(f"Accuracy of form factors must lie between 0 and 1, not {accuracy}")


def form_factors(
    environment: Environment,
    method: str = "auto",
    visibility: str = "auto",
    accuracy: float | None = None,
    seed: int = 0,
    threads: int = 0,
    **options,
) -> FormFactors:
    """Form factors between all patches of an environment, with both identities repaired.

    Parameters
    ----------
    environment : Environment
    method : str
        ``auto``, which chooses for each pair (`automatic`), or one of `METHODS`.
    visibility : str
        ``auto``, or one of the method's own: ``embree`` for rays, ``zbuffer`` for projections, ``bsp`` or
        ``silhouettes`` for exact tests, ``brute_force``; ``none`` where nothing can occlude.
    accuracy : float, optional
        Error wanted of each factor, as of `allowed_error`: a share of it, and of small ones an absolute number. A
        standard error where rays are cast. Hemicube, single plane, disk and point to point take it as an absolute
        number, for the worst factor of each row; so does the hemisphere for many patches (`aimed_rays`). When left out,
        1e-3, or `SAMPLED` for few patches by the hemisphere.
    seed : int
        Same input and seed give the same matrix.
    threads : int
        Threads of the ray engine; 0 takes all cores. The result does not depend on it.
    **options
        Options of the method.

    Returns
    -------
    FormFactors

    Raises
    ------
    SettingsError
        If a name is unknown or a value out of range.
    SceneTooLargeError
        If the matrix would not fit.
    MissingRayEngineError
        If rays are needed and cannot be traced on this platform.
    """
    begin = time.perf_counter()
    check_accuracy(accuracy)
    chooses = method == "auto" and visibility == "auto" and not options
    name, chosen, visibility = find_method(method, visibility, options)
    count = len(environment)
    if accuracy is None:
        accuracy = chosen.accuracy if count <= FEW_PATCHES and not chooses else Method.accuracy
    if count * count > LARGEST_MATRIX:
        raise SceneTooLargeError(
            f"{count} patches need a matrix of {count * count * 8 / 2**30:.1f} GiB, more than "
            f"{LARGEST_MATRIX * 8 / 2**30:.0f}: use fewer than {int(LARGEST_MATRIX**0.5)} patches"
        )
    if chooses:
        rows, counts = automatic_rows(environment, accuracy, seed, threads)
    else:
        rows, counts = chosen.compute(environment, visibility, accuracy, seed, threads, **options), {name: count}
    # As large as the matrix, and of no use to the repair, which needs most of the memory.
    rows = replace(rows, deviations=None)
    areas = environment.areas
    tight = rows.escaped <= CLOSED_SHARE * accuracy + rows.leaks
    closed = bool((areas > 0).any() and tight[areas > 0].all())
    matrix = repair(rows.matrix, areas, closed, rows.samples, rows.variances)
    escaped = np.zeros(count) if closed else rows.escaped
    return FormFactors(
        matrix=matrix,
        escaped=escaped,
        closed=closed,
        seconds=time.perf_counter() - begin,
        rays=int(rows.rays),
        method_counts=counts,
        closure_error=closure_error(matrix, escaped, areas),
        reciprocity_error=reciprocity_error(matrix, areas),
        estimated_error=float(rows.errors.max(initial=0)),
        raw_closure_error=closure_error(rows.matrix, rows.escaped, areas),
        raw_reciprocity_error=reciprocity_error(rows.matrix, areas),
    )
