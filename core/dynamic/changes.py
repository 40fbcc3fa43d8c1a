"""What differs between two scenes, object by object.

Objects are told apart by name: rows of vertices, triangles and palettes shift when an object is added or removed, names
do not. Cost: one pass over the arrays of both. Limits: colors that vary over a triangle are compared by their means.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..scene import Surfaces


@dataclass(frozen=True)
class Changes:
    """Names of objects `added`, `removed`, `moved` (moved, deformed, or of other transparency or sides) and `recolored`
    (in their place, but of other reflectance or emission), each sorted.

    `boxes` (k, 2, 3) are the lowest and highest corners, in meters, of the old and the new place of every object that
    was added, removed or moved: what passes between two points has changed only if the way between them meets a box.
    """

    added: tuple[str, ...]
    removed: tuple[str, ...]
    moved: tuple[str, ...]
    recolored: tuple[str, ...]
    boxes: np.ndarray


@dataclass(frozen=True)
class _Look:
    """One object's triangles: what blocks (t, 11) and what colors (t, 6)."""

    shape: np.ndarray
    colors: np.ndarray

    @property
    def box(self) -> np.ndarray:
        corners = self.shape[:, :9].reshape(-1, 3)
        return np.stack([corners.min(axis=0), corners.max(axis=0)])


def changes_between(before: Surfaces, after: Surfaces) -> Changes:
    """The changes from one state of the surfaces to another. Objects of one name count as one object."""
    old, new = _looks(before), _looks(after)
    both = sorted(old.keys() & new.keys())
    added, removed = sorted(new.keys() - old.keys()), sorted(old.keys() - new.keys())
    moved = [name for name in both if not np.array_equal(old[name].shape, new[name].shape)]
    stayed = sorted(set(both) - set(moved))
    recolored = [name for name in stayed if not np.array_equal(old[name].colors, new[name].colors)]
    boxes = [old[name].box for name in removed + moved] + [new[name].box for name in added + moved]
    return Changes(
        tuple(added), tuple(removed), tuple(moved), tuple(recolored), np.array(boxes, dtype=float).reshape(-1, 2, 3)
    )


def _looks(surfaces: Surfaces) -> dict[str, _Look]:
    """The triangles of each object that has any, by name."""
    names, owners = np.unique(np.asarray(surfaces.object_names, dtype=str), return_inverse=True)
    owners = owners[surfaces.objects]
    order = np.argsort(owners, kind="stable")
    bounds = np.searchsorted(owners[order], np.arange(len(names) + 1))
    corners = np.asarray(surfaces.vertices, dtype=float)[surfaces.triangles].reshape(-1, 9)
    worn = surfaces.palette_of(np.arange(len(corners)))
    shape = np.column_stack([corners, surfaces.transmittance[worn], surfaces.two_sided])[order]
    colors = np.column_stack([surfaces.reflectance[worn], surfaces.emission[worn]])[order]
    spans = [slice(start, stop) for start, stop in pairwise(bounds)]
    return {
        str(name): _Look(shape[span], colors[span])
        for name, span in zip(names, spans, strict=True)
        if span.stop > span.start
    }
