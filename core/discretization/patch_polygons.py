"""Polygons of patches: what form-factor methods take, made from what rays hit.

A cell of a big triangle is a triangle, and so is each part of a split cell. A cluster of small triangles is no polygon
at all: each of its triangles becomes one, and `over_patches` averages their form factors over it, elements in the terms
of the survey (eq. 12-13, figure 14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .patches import Patches


@dataclass(frozen=True)
class PatchPolygons:
    """Triangles that make up the patches.

    Parameters
    ----------
    corners : (k, 3, 3) float64
        Counter-clockwise seen from the front of the patch.
    patches : (k,) int
        Patch of each.
    """

    corners: np.ndarray
    patches: np.ndarray

    @classmethod
    def of(cls, patches: Patches, vertices: np.ndarray, triangles: np.ndarray) -> PatchPolygons:
        """Polygons of all patches with an area, of the traced mesh: vertices (n, 3) and triangles (m, 3)."""
        vertices = np.asarray(vertices, dtype=np.float64)
        # A triangle that was split once more has no area of its own; its parts follow among the cells.
        whole = np.flatnonzero((patches.divisions <= 1) & (patches.areas[patches.first] > 0))
        rest = patches.areas > 0
        rest[patches.first[whole]] = False
        cells = np.flatnonzero(rest)
        second_third = patches.cell_corners[cells]
        weights = np.concatenate([1 - second_third.sum(axis=2, keepdims=True), second_third], axis=2)
        divided = np.einsum("pcw,pwi->pci", weights, vertices[triangles[patches.point_triangles[cells, 0]]])
        owners = np.concatenate([cells, patches.first[whole]])
        order = np.argsort(owners, kind="stable")
        return cls(np.concatenate([divided, vertices[triangles[whole]]])[order], owners[order])

    @staticmethod
    def count_of(patches: Patches) -> int:
        """How many polygons there would be, at no cost."""
        whole = (patches.divisions <= 1) & (patches.areas[patches.first] > 0)
        clustered = np.unique(patches.first[whole])
        return int((patches.areas > 0).sum()) - len(clustered) + int(whole.sum())


def over_patches(matrix: np.ndarray, areas: np.ndarray, owners: np.ndarray, count: int) -> np.ndarray:
    """Form factors (count, count) between groups of polygons from those (k, k) between the polygons themselves.

    Rows are averaged by area, columns summed: what reaches any element of a patch reaches the patch.

    Parameters
    ----------
    matrix : (k, k) float
    areas : (k,) float
    owners : (k,) int
        Group of each polygon.
    count : int
        Number of groups.

    Returns
    -------
    (count, count) float64
        The matrix itself where each group has one polygon, in order.

    References
    ----------
    .. [1] Cohen, Greenberg, Immel, Brock, "An Efficient Radiosity Approach for Realistic Image Synthesis", IEEE CG&A
       1986; Pueyo's survey, eq. 12 and 13.
    """
    if len(owners) == count and (owners == np.arange(count)).all():
        return matrix
    summed = np.zeros((count, len(owners)))
    np.add.at(summed, owners, matrix * areas[:, None])
    out = np.zeros((count, count))
    np.add.at(out.T, owners, summed.T)
    totals = np.bincount(owners, areas, count)
    return out / np.where(totals > 0, totals, 1)[:, None]
