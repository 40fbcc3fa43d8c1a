"""Form factors inside the cells of a partition, each cell by itself, by any method (survey section 3).

A cell is an environment of its own: the pieces of patches in it, and the portals around it as patches that face inward.
So n patches in m cells alike cost m matrices of (n / m)^2 entries in place of n^2, and what a method spends on blockers
is spent on those of the cell alone. Cells know nothing of each other: they may be computed in several processes, whose
number changes no bit.

Limits: a patch cut by planes has a part in several cells, and one radiosity for all of them. Processes are started
anew, not forked, and each imports the package; that needs a program that can be imported as well, which Blender is not.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..discretization.local_environments import Partition
from ..environment import Environment
from ..errors import SettingsError
from ..form_factors.matrix import form_factors


@dataclass(frozen=True)
class CellFactors:
    """Form factors of a cell's m patches and s portals, in this order.

    Attributes
    ----------
    patches : (m,) int64
        Patches of the scene that have a part in the cell, ascending.
    sides : (s,) int64
        Portals seen from here: twice the portal's number, plus 1 where the cell lies behind it.
    areas : (m + s,) float64
        Radiating areas of the parts, and of the portals.
    matrix : (m + s, m + s) float64
        Share of the power leaving the part in the row that reaches the one in the column.
    error : float
        Of the worst factor between pieces, as the method estimates it.
    """

    patches: np.ndarray
    sides: np.ndarray
    areas: np.ndarray
    matrix: np.ndarray
    error: float


def cell_factors(
    partition: Partition,
    method: str = "auto",
    visibility: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    workers: int = 1,
    **options,
) -> list[CellFactors]:
    """Form factors of all cells.

    Parameters
    ----------
    partition : Partition
    method, visibility, accuracy, seed, threads, **options
        As in `radiosity.core.form_factors`.
    workers : int
        Processes; 1 computes here, 0 takes one for each core. The result does not depend on it.

    Raises
    ------
    SettingsError
        If a name is unknown or a value out of range.
    """
    if workers != int(workers) or workers < 0:
        raise SettingsError(f"Workers must be a whole number, 0 or more, not {workers}")
    workers = min(workers or os.cpu_count() or 1, partition.count)
    cells = [_local_environment(partition, cell) for cell in range(partition.count)]
    choices = {"method": method, "visibility": visibility, "accuracy": accuracy, "seed": seed} | options
    if workers == 1:
        return [_factors(cell, choices | {"threads": threads}) for cell in cells]
    # The engine's threads share the cores that processes leave.
    choices["threads"] = threads or max(1, (os.cpu_count() or 1) // workers)
    # Ray engines have threads, which a forked process would lack.
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(_factors, cells, [choices] * len(cells)))


def _local_environment(partition, cell):
    """Polygons, which of them have two sides, the patch or portal side of each, and how many are patches'."""
    rows = np.flatnonzero(partition.cells == cell)
    numbers, sides = np.nonzero(partition.portal_cells == cell)
    polygons = [partition.pieces.polygons[row] for row in rows]
    for portal, side in zip(numbers, sides, strict=True):
        polygon = partition.portals.polygons[portal]
        polygons.append(polygon[::-1] if side else polygon)
    two_sided = np.concatenate((partition.pieces.two_sided[rows], np.zeros(len(numbers), bool)))
    return polygons, two_sided, partition.patches[rows], 2 * numbers + sides


def _factors(cell, choices):
    """`CellFactors` of a local environment; a function of the module, as processes take no other."""
    polygons, two_sided, owners, sides = cell
    patches, places = np.unique(owners, return_inverse=True)
    count = len(patches) + len(sides)
    if not polygons:
        return CellFactors(patches, sides, np.zeros(0), np.zeros((0, 0)), 0.0)
    local = Environment.from_polygons(polygons, two_sided=two_sided)
    found = form_factors(local, **choices)
    groups = np.concatenate((places.reshape(-1), len(patches) + np.arange(len(sides))))
    areas = np.bincount(groups, local.areas, count)
    if len(groups) == count and (groups == np.arange(count)).all():
        return CellFactors(patches, sides, areas, found.matrix, found.estimated_error)
    # Row by row the mean over a part's pieces weighted by area, survey eq. 12; column by column their sum.
    members = (np.arange(count)[:, None] == groups).astype(np.float64)
    exchange = members @ (local.areas[:, None] * found.matrix) @ members.T
    matrix = exchange / np.where(areas > 0, areas, 1)[:, None]
    return CellFactors(patches, sides, areas, matrix, found.estimated_error)
