"""Receivers: points of faces over which factors of a point are averaged to those of a patch, and rows from them.

A face is cut evenly into cells, and each cell gets a few random points that balance about its center. Linear changes
average out exactly then, so smooth factors need few points, and independent draws still tell the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..visibility.zbuffer import ranges
from .cells import Cells
from .faces import Faces
from .hemisphere import SampledRows


@dataclass(frozen=True)
class Receivers:
    """Points of rows, and what each weighs in its row's average."""

    points: np.ndarray
    normals: np.ndarray
    rows: np.ndarray
    weights: np.ndarray

    @classmethod
    def on(cls, cells, faces, block, parts, generator):
        """Points on the faces of a block, whose `cells` are cut into `parts` along each side.

        Each part gets random points that together balance about its center: linear changes average out exactly.
        """
        order = np.full(len(faces), -1)
        order[block] = np.arange(len(block))
        # Drawn for all, so that a row's points do not depend on the rows that share its block.
        first = generator.random((len(cells) * parts * parts, 2))
        fine = cells.divided(parts)
        first = np.where((fine.triangular & (first.sum(axis=1) > 1))[:, None], 1 - first, first)
        kept = order[fine.patches] >= 0
        fine, first = fine[kept], first[kept]
        u, v = first.T
        turns = [(u, v), np.where(fine.triangular, (v, 1 - u - v), (1 - u, 1 - v)), (1 - u - v, u)]
        counts = np.where(fine.triangular, 3, 2)
        places, which = [], []
        for number, (a, b) in enumerate(turns):
            chosen = np.flatnonzero(counts > number)
            places.append((fine.origins + a[:, None] * fine.u + b[:, None] * fine.v)[chosen])
            which.append(chosen)
        which = np.concatenate(which)
        owners = fine.patches[which]
        weights = (fine.areas() / counts)[which] / faces.areas[owners]
        return cls(np.concatenate(places), faces.normals[owners], order[owners], weights)


def face_cells(environment: Environment, faces: Faces) -> Cells:
    """Cells of faces, numbered as these are; backs of two-sided patches wind the other way."""
    cells = Cells.of(environment)
    front = np.full(len(environment), -1)
    back = front.copy()
    fronts = int((environment.areas > 0).sum())
    front[faces.owners[:fronts]] = np.arange(fronts)
    back[faces.owners[fronts:]] = np.arange(fronts, len(faces))
    behind = cells[back[cells.patches] >= 0]
    return Cells(
        np.concatenate((cells.origins, behind.origins)),
        np.concatenate((cells.u, behind.v)),
        np.concatenate((cells.v, behind.u)),
        np.concatenate((cells.triangular, behind.triangular)),
        np.concatenate((front[cells.patches], back[behind.patches])),
    )


class FaceCells:
    """Cells of faces, found by face."""

    def __init__(self, environment: Environment, faces: Faces):
        cells = face_cells(environment, faces)
        self.cells = cells[np.argsort(cells.patches, kind="stable")]
        self.counts = np.bincount(cells.patches, minlength=len(faces))
        self.starts = np.cumsum(self.counts) - self.counts

    def of(self, faces: np.ndarray) -> tuple[np.ndarray, Cells]:
        """Place (c,) in `faces` (m,) that each cell belongs to, ascending, and the cells."""
        which, rows = ranges(self.starts[faces], self.counts[faces])
        return which, self.cells[rows]


def patch_rows(environment: Environment, faces: Faces, values, errors, used, rays: int) -> SampledRows:
    """Rows of patches from those of faces."""
    count = len(environment)
    exchange, worst, samples = np.zeros((count, count)), np.zeros(count), np.zeros(count, dtype=np.int64)
    np.add.at(exchange, (faces.owners[:, None], faces.owners), faces.areas[:, None] * values)
    np.maximum.at(worst, faces.owners, errors)
    np.add.at(samples, faces.owners, used)
    areas = environment.areas
    matrix = np.minimum(exchange / np.where(areas > 0, areas, 1)[:, None], 1)
    escaped = np.maximum(1 - matrix.sum(axis=1), 0)
    return SampledRows(matrix, escaped, worst, np.maximum(samples, 1), rays, np.zeros(count))
