"""Rows of form factors by projection, and cropped hemicubes for the pairs that they leave uncertain.

Whole hemicubes and planes know all factors of a row to about the same absolute error, which is more than small and
distant patches can bear. Pairs that need it are looked at again from the smaller patch, through windows that show
nothing but the other: see `cropped`.

Cost: a tenth of a second to some seconds a pair; so it is left out among more than `FEW_PATCHES` patches, where the
accuracy stays one absolute error for a row. Limits: those of `cropped`; patches of extreme aspect take long.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from .allowed_error import AIM, allowed_error
from .cropped import SAFETY, cropped_pair
from .hemicube import RESOLUTION, hemicube_rows
from .hemisphere import SampledRows
from .single_plane import RESOLUTION as PROXELS
from .single_plane import single_plane_rows
from .uncertain_pairs import FEW_PATCHES, Look, with_uncertain_pairs


def hemicube_factors(
    environment: Environment,
    visibility: str,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    resolution: int | None = None,
) -> SampledRows:
    """Form factors of all patches by hemicubes, and by cropped ones for what these leave uncertain.

    Parameters are those of `hemicube_rows`, but `accuracy` is that of `allowed_error` up to `FEW_PATCHES` patches. A
    resolution that is named is that of all hemicubes: no pair is looked at again, for its error is to be seen.
    """
    pixels = RESOLUTION if resolution is None else resolution
    rows = hemicube_rows(environment, visibility, accuracy, seed, threads, pixels)
    return _with_cropped_pairs(environment, rows, accuracy, seed) if resolution is None else rows


def single_plane_factors(
    environment: Environment,
    visibility: str,
    accuracy: float,
    seed: int = 0,
    threads: int = 0,
    resolution: int | None = None,
    lost: float | None = None,
) -> SampledRows:
    """Form factors of all patches by single planes, and by cropped hemicubes for what these leave uncertain.

    What passes beside the plane is found by them, too. Parameters are those of `single_plane_rows`, but `accuracy` is
    that of `allowed_error` up to `FEW_PATCHES` patches. Where a resolution or a lost share is named, no pair is looked
    at again, for its error is to be seen.
    """
    proxels = PROXELS if resolution is None else resolution
    rows = single_plane_rows(environment, visibility, accuracy, seed, threads, proxels, lost)
    unnamed = resolution is None and lost is None
    return _with_cropped_pairs(environment, rows, accuracy, seed) if unnamed else rows


def _with_cropped_pairs(environment, rows, accuracy, seed):
    if len(environment) > FEW_PATCHES:
        return rows
    return with_uncertain_pairs(environment, rows, accuracy, cropped_hemicubes(environment, accuracy, seed))


def cropped_hemicubes(environment: Environment, accuracy: float, seed: int) -> Look:
    """A closer look at pairs of patches, as of `uncertain_pairs`."""
    share, least = (SAFETY * AIM * error for error in (accuracy, allowed_error(0.0, accuracy)))

    def look(first, second, guesses):
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        found = np.array([cropped_pair(environment, one, other, share, seed, least) for one, other in pairs])
        return found[:, 0], found[:, 1], 0

    return look
