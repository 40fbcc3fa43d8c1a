"""Cells: parallelograms and triangles that patches are divided into, evenly or where it matters, as whole arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment

#: Deviation from a parallelogram, in diagonals, below which four corners count as one.
SKEW = 1e-12


@dataclass(frozen=True)
class Cells:
    """Plane cells.

    Attributes
    ----------
    origins, u, v : (c, 3) float
        A corner, and the sides that leave it, counter-clockwise from u to v.
    triangular : (c,) bool
        Whether the cell is the triangle between the sides, or the whole parallelogram.
    patches : (c,) int
        Patch that each belongs to.
    """

    origins: np.ndarray
    u: np.ndarray
    v: np.ndarray
    triangular: np.ndarray
    patches: np.ndarray

    def __len__(self) -> int:
        return len(self.origins)

    def __getitem__(self, rows) -> Cells:
        return Cells(self.origins[rows], self.u[rows], self.v[rows], self.triangular[rows], self.patches[rows])

    @classmethod
    def of(cls, environment: Environment) -> Cells:
        """Few cells per patch: one for a parallelogram, else its triangles; none where there is no area."""
        rows = []
        for patch, polygon in enumerate(environment.polygons):
            if environment.areas[patch] > 0 and len(polygon) == 4:
                skew = np.abs(polygon[0] - polygon[1] + polygon[2] - polygon[3]).max()
                if skew <= SKEW * np.abs(polygon[2] - polygon[0]).max():
                    rows.append(patch)
        rows = np.array(rows, dtype=np.int64)
        loops = np.array([environment.polygons[row] for row in rows]).reshape(-1, 4, 3)
        others = ~np.isin(environment.triangle_patches, rows)
        corners = environment.vertices[environment.triangles[others]]
        cells = cls(
            np.concatenate((loops[:, 0], corners[:, 0])),
            np.concatenate((loops[:, 1] - loops[:, 0], corners[:, 1] - corners[:, 0])),
            np.concatenate((loops[:, 3] - loops[:, 0], corners[:, 2] - corners[:, 0])),
            np.repeat([False, True], [len(loops), len(corners)]),
            np.concatenate((rows, environment.triangle_patches[others])),
        )
        return cells[np.argsort(cells.patches, kind="stable")]

    def areas(self) -> np.ndarray:
        """(c,) areas."""
        return np.linalg.norm(np.cross(self.u, self.v), axis=1) * np.where(self.triangular, 0.5, 1)

    def centers(self) -> np.ndarray:
        """(c, 3) centers of area."""
        return self.origins + (self.u + self.v) * np.where(self.triangular, 1 / 3, 0.5)[:, None]

    def radii(self) -> np.ndarray:
        """(c,) distances of the farthest corner from the center."""
        share = np.where(self.triangular, 1 / 3, 0.5)[:, None]
        middle = (self.u + self.v) * share
        corners = (-middle, self.u - middle, self.v - middle)
        squares = np.max([np.einsum("ci,ci->c", corner, corner) for corner in corners], axis=0)
        return np.sqrt(squares)

    def points(self, square: np.ndarray) -> np.ndarray:
        """(c, 3) points spread evenly over each cell, from (c, 2) numbers between 0 and 1."""
        # The half of the parallelogram beyond the triangle is turned back onto it.
        beyond = self.triangular & (square.sum(axis=1) > 1)
        square = np.where(beyond[:, None], 1 - square, square)
        return self.origins + square[:, :1] * self.u + square[:, 1:] * self.v

    def divided(self, parts: int) -> Cells:
        """Each cell cut into `parts` by `parts` of its own shape, which follow each other."""
        count = parts * parts
        steps = np.array([(i, j) for i in range(parts) for j in range(parts)], dtype=np.float64)
        # Rows of a triangle's parallelogram beyond its third side become the triangles that stand on their heads.
        beyond = steps.sum(axis=1) > parts - 1
        turned = np.where(beyond[:, None], parts - steps, steps)
        flip = np.where(beyond, -1.0, 1.0)
        triangular = np.repeat(self.triangular, count)
        place = np.where(triangular[:, None], np.tile(turned, (len(self), 1)), np.tile(steps, (len(self), 1))) / parts
        scale = (np.where(triangular, np.tile(flip, len(self)), 1) / parts)[:, None]
        u, v = np.repeat(self.u, count, axis=0), np.repeat(self.v, count, axis=0)
        origins = np.repeat(self.origins, count, axis=0) + place[:, :1] * u + place[:, 1:] * v
        return Cells(origins, scale * u, scale * v, triangular, np.repeat(self.patches, count))
