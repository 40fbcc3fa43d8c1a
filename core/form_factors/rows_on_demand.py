"""Rows of form factors when they are asked for, by any method, in place of a whole matrix.

A solver that shoots needs the row of a patch when that patch shoots, and some patches never do; elements of a hierarchy
need factors to patches only, and none among themselves. `rows_on_demand` gives a function of patches; its method `of`
does the same for other polygons that lie on them.

Rows are as computed, each by itself: reciprocity and closure, which are repaired in whole matrices, hold up to the
accuracy only. A row does not depend on which others are asked for, or when.

=================  ============================================  =====================
method             a row costs                                   receivers other than
                                                                 patches
=================  ============================================  =====================
hemisphere         its rays                                      yes
hemicube           its projections                               yes
single_plane       its projections                               yes
contour_integral   n contours, and segments where visibility     yes
                   is asked for
point_to_polygon   n integrals, and segments as above            yes, but with ``bsp``
point_to_point     the whole matrix, once                        no
disk               the whole matrix, once                        no
hybrid             the whole matrix, once                        no
=================  ============================================  =====================

``auto`` takes the contour integral where no polygon can stand between two others, and the hemisphere else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.segments import make_visibility
from .automatic import FAST_ACCURACY, FAST_SHARE, MOST_PATCHES
from .clipped_quadrature import ClippedQuadrature
from .contour_integral import NEAR, face_block
from .faces import Faces, smaller_first
from .hemicube import hemicubes
from .hemisphere import FALLS, RowCaster
from .matrix import check_accuracy, find_method, form_factors
from .pair_rows import BLOCK_ENTRIES, blockable_faces
from .projection import ProjectedRows
from .segment_samples import SegmentSamples
from .separated_pairs import GREATEST_RATIO
from .single_plane import single_planes
from .visible_share import visible_shares

#: Numbers that rows kept for a second request may have together: 1 GiB.
MOST_KEPT = 2**27


@dataclass(frozen=True)
class Receivers:
    """Polygons that lie on patches.

    Attributes
    ----------
    environment : Environment
        The polygons, each facing as its patch does.
    patches : (r,) int
        Patch that each lies on, and does not see.
    names : (r,) int
        Numbers, one for each polygon that ever is a receiver, by which random places are drawn.
    """

    environment: Environment
    patches: np.ndarray
    names: np.ndarray


class RowsOnDemand:
    """Rows of form factors between the patches of an environment; made by `rows_on_demand`.

    Attributes
    ----------
    method : str
        What computes them.
    computed : int
        Rows computed so far; a row that was kept is computed once.
    """

    def __init__(self, count: int, method: str, own: Callable, of: Callable[[Receivers], np.ndarray] | None):
        self.method, self.computed = method, 0
        self._own, self._of = own, of
        self._count, self._kept = count, {}

    def __call__(self, patches: np.ndarray) -> np.ndarray:
        """Rows (b, n) of b patches: shares of the power leaving each that reach each patch."""
        patches = np.asarray(patches)
        missing = np.array([patch for patch in patches.tolist() if patch not in self._kept], dtype=np.int64)
        fresh = self._own(missing) if len(missing) else np.zeros((0, self._count))
        self.computed += len(missing)
        new = dict(zip(missing.tolist(), fresh, strict=True))
        for patch, row in new.items():
            if len(self._kept) * self._count < MOST_KEPT:
                self._kept[patch] = row.copy()
        return np.array([self._kept[patch] if patch in self._kept else new[patch] for patch in patches.tolist()])

    def of(self, receivers: Receivers) -> np.ndarray:
        """Rows (r, n) of other polygons that lie on patches.

        Raises
        ------
        SettingsError
            If the method knows patches only.
        """
        if self._of is None:
            raise SettingsError(
                f"Rows of elements do not exist by {self.method}: choose hemisphere, hemicube, single_plane, "
                "contour_integral, or point_to_polygon without bsp"
            )
        self.computed += len(receivers.names)
        return self._of(receivers)


def rows_on_demand(
    environment: Environment,
    method: str = "auto",
    visibility: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    **options,
) -> RowsOnDemand:
    """A function that computes rows of form factors.

    The parameters are those of `radiosity.core.form_factors`; nothing is computed yet.

    Raises
    ------
    SettingsError
        If a name is unknown or a value out of range.
    MissingRayEngineError
        If rays are needed and cannot be traced on this platform.
    """
    check_accuracy(accuracy)
    if method == "auto" and visibility == "auto" and not options and _nothing_blocks(environment):
        method, visibility = "contour_integral", "none"
        options = {"fast": accuracy >= FAST_ACCURACY}
        accuracy = FAST_SHARE * accuracy
    name, _, sight = find_method(method, visibility, options)
    if name == "point_to_polygon" and sight == "bsp":
        own, of = _clipped(environment, accuracy), None
    elif name in _SOURCES:
        own, of = _SOURCES[name](environment, sight, accuracy, seed, threads, **options)
    else:
        own, of = _whole(environment, name, sight, accuracy, seed, threads, options), None
    return RowsOnDemand(len(environment), name, own, of)


def _nothing_blocks(environment):
    return len(environment) <= MOST_PATCHES and not blockable_faces(Faces(environment)).any()


def _hemisphere(environment, visibility, accuracy, seed, threads, sampling="low_discrepancy"):
    if sampling not in FALLS:
        raise SettingsError(f"Unknown sampling {sampling!r} of the hemisphere: choose {', '.join(FALLS)}")
    caster = RowCaster(environment, threads, sampling)

    def of(receivers):
        others = caster.of_receivers(receivers.environment, receivers.names)
        return others.refined(np.arange(len(receivers.names)), accuracy, seed)[0]

    return lambda patches: caster.refined(patches, accuracy, seed)[0], of


def _projected(environment, cameras, accuracy, seed):
    scene = ProjectedRows(environment, cameras)

    def of(receivers):
        others = scene.of_receivers(receivers.environment, receivers.names, receivers.patches)
        return others.refined(np.arange(len(receivers.names)), accuracy, seed)[0]

    return lambda patches: scene.refined(patches, accuracy, seed)[0], of


def _hemicube(environment, visibility, accuracy, seed, threads, **options):
    return _projected(environment, hemicubes(**options), accuracy, seed)


def _single_plane(environment, visibility, accuracy, seed, threads, **options):
    return _projected(environment, single_planes(accuracy, **options), accuracy, seed)


def _point_to_polygon(environment, visibility, accuracy, seed, threads):
    return _pairwise(environment, visibility, accuracy, seed, threads, 0.0, GREATEST_RATIO)


def _contour_integral(environment, visibility, accuracy, seed, threads, fast=False):
    return _pairwise(environment, visibility, accuracy, seed, threads, accuracy if fast else 0.0, NEAR)


def _pairwise(environment, visibility, accuracy, seed, threads, allowed, near):
    sight = None if visibility == "none" else make_visibility(visibility, environment, threads)
    usable = np.flatnonzero(environment.areas > 0)
    targets = _part(environment, usable)
    step = max(1, BLOCK_ENTRIES // max(len(usable), 1))

    def of(receivers):
        rows = np.zeros((len(receivers.names), len(environment)))
        chosen = np.flatnonzero(receivers.environment.areas > 0)
        for block in np.split(chosen, range(step, len(chosen), step)):
            rows[block[:, None], usable] = block_rows(_part(receivers.environment, block), receivers.names[block])
        return rows

    def block_rows(senders, names):
        both = _joined(senders, targets)
        faces = Faces(both)
        here, there = (np.flatnonzero(side) for side in (faces.owners < len(names), faces.owners >= len(names)))
        values = face_block(faces, here, there, allowed, near=near)[0]
        if sight is not None:
            samples = SegmentSamples(both, faces, sight)
            # Row by row, so that each has random places of its own.
            for row, face in enumerate(here):
                lit = np.flatnonzero(values[row])
                pairs = np.full(len(lit), face), there[lit]
                factors = values[row, lit] / np.minimum(faces.areas[face], faces.areas[there[lit]])
                key = (seed, int(names[faces.owners[face]]))
                values[row, lit] *= visible_shares(samples, *pairs, factors, accuracy, key)[0]
        rows = np.zeros((len(names), len(usable)))
        np.add.at(rows, (faces.owners[here][:, None], faces.owners[there] - len(names)), values)
        return np.minimum(rows / senders.areas[:, None], 1)

    def own(patches):
        rows = np.zeros((len(patches), len(environment)))
        chosen = np.flatnonzero(environment.areas[patches] > 0)
        part = patches[chosen]
        if len(part):
            rows[chosen] = of(Receivers(_part(environment, part), part, part))
        return rows

    return own, of


def _clipped(environment, accuracy):
    quadrature = ClippedQuadrature(environment)
    count = len(environment)

    def own(patches):
        rows, columns = np.repeat(patches, count), np.tile(np.arange(count), len(patches))
        areas = environment.areas
        # Points go to the smaller patch, ties to the lower number, as in the matrix; reciprocity carries over.
        first, second = np.minimum(rows, columns), np.maximum(rows, columns)
        receivers, sources = smaller_first(areas, first, second)
        asked = rows != columns
        factors = np.zeros(len(rows))
        factors[asked] = quadrature.pairs(receivers[asked], sources[asked], np.full(int(asked.sum()), accuracy))[0]
        ratio = areas[receivers] / np.where(areas[rows] > 0, areas[rows], 1)
        return (factors * ratio).reshape(len(patches), count)

    return own


def _whole(environment, name, visibility, accuracy, seed, threads, options):
    matrix = None

    def own(patches):
        nonlocal matrix
        if matrix is None:
            matrix = form_factors(environment, name, visibility, accuracy, seed, threads, **options).matrix
        return matrix[patches]

    return own


def _part(environment, patches):
    return Environment.from_polygons(
        [environment.polygons[patch] for patch in patches],
        environment.reflectance[patches],
        environment.emission[patches],
        environment.two_sided[patches],
    )


def _joined(first, second):
    return Environment.from_polygons(
        [*first.polygons, *second.polygons],
        np.concatenate((first.reflectance, second.reflectance)),
        np.concatenate((first.emission, second.emission)),
        np.concatenate((first.two_sided, second.two_sided)),
    )


_SOURCES = {
    "hemisphere": _hemisphere,
    "hemicube": _hemicube,
    "single_plane": _single_plane,
    "contour_integral": _contour_integral,
    "point_to_polygon": _point_to_polygon,
}
