"""Light groups: the light of some lamps, emissive faces or the sky, kept apart from that of the others.

Light adds up: what one group of lights does to a scene is independent of what the others do, so that each can be dimmed
or colored afterwards without solving anything again. A bake with groups therefore carries more columns through the same
work: three for the whole, on which every choice is made (which rays are sent, where nodes lie, when bounces stop), and
three for each group after them, which follow those choices. Rays are sent once for all; the whole is what it would be
without groups.

Few steps are not linear: values are kept from falling below zero, and a solver stops at a tolerance. What the groups
then miss of the whole is given to them in proportion (`shared_out`), so that their sum is the whole to rounding.

Cost: the look-ups and products of a bake, not its rays, grow with 1 + the number of groups; so do the light of all
receivers and the tables. Limits: emissive faces of one look in different groups are no longer taken as one light or
merged, so the whole may differ from that of a bake without groups, within the error of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Columns of one group: red, green, blue.
BANDS = 3


@dataclass(frozen=True)
class LightGroups:
    """Which group each source of light of a `Scene` belongs to, as rows of `names`.

    Parameters
    ----------
    names : tuple of str
    lights : (l,) int
        Of `Scene.lights`.
    objects : (o,) int
        Of what the objects `Surfaces.object_names` emit.
    receivers : (r,) int
        Of what the meshes `Scene.receivers` themselves emit, which is part of their look.
    sky : int
    """

    names: tuple[str, ...]
    lights: np.ndarray
    objects: np.ndarray
    receivers: np.ndarray
    sky: int


def whole(values: np.ndarray) -> np.ndarray:
    """The first three columns (..., 3) of values (..., c), a view: of all groups together."""
    return values[..., :BANDS]


def spread(colors: np.ndarray, groups: np.ndarray | None, count: int) -> np.ndarray:
    """Colors (n, 3) as columns (n, 3 + 3 count): the whole, and again at the group (n,) that each belongs to."""
    if not count:
        return colors
    out = np.zeros((len(colors), 1 + count, BANDS), colors.dtype)
    out[:, 0] = colors
    out[np.arange(len(colors)), 1 + groups] = colors
    return out.reshape(len(colors), -1)


def repeated(colors: np.ndarray, columns: int) -> np.ndarray:
    """Factors (n, 3) that hold for every group alike, as (n, columns)."""
    return colors if columns == BANDS else np.tile(colors, (1, columns // BANDS))


def joined(direct: np.ndarray, indirect: np.ndarray) -> np.ndarray:
    """Light (n, 2 c) from direct and indirect (n, c): six columns for the whole, then six for each group."""
    parts = [values.reshape(len(values), values.shape[1] // BANDS, BANDS) for values in (direct, indirect)]
    return np.concatenate(parts, axis=2).reshape(len(direct), 2 * direct.shape[1])


def total(light: np.ndarray) -> np.ndarray:
    """(n, 3) direct and indirect light of the whole together, of light (n, 2 c) as `joined` makes it."""
    return light[:, :BANDS] + light[:, BANDS : 2 * BANDS]


def level(light: np.ndarray) -> np.ndarray:
    """(n,) sums over direct and indirect light and channels of the whole, of light (n, 2 c) as `joined` makes it."""
    return light[:, : 2 * BANDS].sum(axis=1)


def shared_out(light: np.ndarray) -> np.ndarray:
    """Light (n, 2 c) with the groups adjusted so that they add up to the whole, to rounding, and none is negative.

    Where no group claims what the whole has, the groups share it as they do on the mean.
    """
    parts = light.reshape(len(light), -1, 2 * BANDS).copy()
    total, groups = parts[:, 0], parts[:, 1:]
    if not groups.shape[1]:
        return light
    np.maximum(groups, 0, out=groups)
    sums = groups.sum(axis=1)
    unclaimed = (sums <= 0) & (total > 0)
    if unclaimed.any():
        means = groups.mean(axis=0, dtype=np.float64).astype(light.dtype)
        means[:, ~(means.sum(axis=0) > 0)] = 1
        who, column = np.nonzero(unclaimed)
        groups[who, :, column] = means[:, column].T
        sums = groups.sum(axis=1)
    groups *= (total / np.where(sums > 0, sums, 1))[:, None]
    return parts.reshape(light.shape)
