"""Closed form times visible share: the factors from a point to all polygons, for the two analytic methods.

At a point the double contour integral has lost one of its two integrals, and what is left is Lambert's sum over the
other outline: the contour integral and the factor from a point to a polygon are one. Segments toward places spread over
each polygon tell which share of it the point sees; polygons of which some are seen and some are not get more.

Cost: about a microsecond and four segments for each point and polygon before it. Limits: a blocker that falls between
the segments is overlooked, at most a 20th of a polygon where any of them has met it.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment
from ..visibility.segments import make_visibility
from .cells import Cells
from .faces import Faces
from .hybrid import piece_factors
from .point_rows import PointRows
from .receivers import face_cells

#: Parts along each side of a cell, in each of which one segment ends; the second for what is partly hidden.
PARTS, MORE_PARTS = 2, 4


def visible_polygon_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments.
    accuracy : float
        Not used: geometry is exact, and the segments' number is fixed.
    seed : int
        Of the places where segments end.
    threads : int
        Threads of the ray engine, where it is used.

    Returns
    -------
    PointRows

    Raises
    ------
    SettingsError
        If the visibility is unknown.
    MissingRayEngineError
        If rays are needed and cannot be traced on this platform.
    """
    faces = Faces(environment)
    cells = face_cells(environment, faces)
    owners = faces.owners[cells.patches]
    sight = make_visibility(visibility, environment, threads)
    count = len(environment)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        which, cell = (index.ravel() for index in np.indices((len(points), len(cells))))
        factors = piece_factors(points[which], normals[which], cells[cell])
        lit = np.flatnonzero(factors > 0)
        which, cell, factors = which[lit], cell[lit], factors[lit]
        generator = np.random.default_rng((seed, int(names[0])))
        shares = seen_parts(points[which], normals[which], cells[cell], PARTS, sight, generator)
        mixed = np.flatnonzero((shares > 0) & (shares < 1))
        finer = seen_parts(
            points[which[mixed]], normals[which[mixed]], cells[cell[mixed]], MORE_PARTS, sight, generator
        )
        parts = np.array([PARTS, MORE_PARTS]) ** 2
        shares[mixed] = (parts[0] * shares[mixed] + parts[1] * finer) / parts.sum()
        keys = which * count + owners[cell]
        return np.bincount(keys, factors * shares, len(points) * count).reshape(len(points), count)

    return rows


def seen_parts(points, normals, pieces: Cells, parts: int, sight, generator: np.random.Generator) -> np.ndarray:
    """Share (w,) of the light from each piece that reaches its point (w, 3), by one segment to a random place in each
    of `parts` by `parts` parts, which weighs what it would carry: nothing below the horizon."""
    fine = pieces.divided(parts)
    each = parts * parts
    rays = fine.points(generator.random((len(fine), 2))) - np.repeat(points, each, axis=0)
    squares = np.einsum("wi,wi->w", rays, rays)
    here = np.maximum(np.einsum("wi,wi->w", rays, np.repeat(normals, each, axis=0)), 0)
    there = np.abs(np.einsum("wi,wi->w", rays, np.cross(fine.u, fine.v)))
    # A disk as large as the part keeps the weight finite where the point nearly touches it.
    weights = here * there / (squares * (np.pi * squares + fine.areas()))
    asked = np.flatnonzero(weights > 0)
    seen = np.zeros(len(fine))
    origins = points[asked // each]
    seen[asked] = sight.visible(origins, origins + rays[asked])
    total = weights.reshape(-1, each).sum(axis=1)
    carried = (weights * seen).reshape(-1, each).sum(axis=1)
    # Where all places lie below the horizon, next to nothing of the piece is above it.
    return np.where(total > 0, carried / np.where(total > 0, total, 1), 1)
