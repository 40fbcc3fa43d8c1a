"""Radiosity of the patches by a full matrix: form factors by a method chosen by name, a solver chosen by name.

The other way to solve the patches, and a part of the same house: direct light, the light of the sky, the backs that
are met, and what lies inside solids are found as in `PatchSolution`, by rays. What differs is the exchange between
patches: their polygons make an environment, the method fills its matrix, and the solver sums the bounces. Receivers
then take the light of the patches by the same method, from the point (`form_factors.point_rows`), or, where only a
solver was named, by rays. What stands next to them is asked by rays again, in any case.

Choose it to see what a method does in a scene, to compare methods, or where one is wanted for its own sake; the
automatic bake is sooner done and more accurate. Fronts and backs are polygons of their own, one-sided each, so that
the two sides of a wall have their own light; backs that no patch sees are none, as they give nothing back.

Cost: the method's for n polygons, at least n squared factors. Limits: patches are few, so shadows of bounced light are
coarse; translucent surfaces do not exist for polygons (`core.matrix_plan` refuses them).
"""

from __future__ import annotations

import warnings
from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np

from ..discretization.patch_polygons import PatchPolygons, over_patches
from ..environment import Environment
from ..form_factors.matrix import METHODS, FormFactors, form_factors
from ..form_factors.point_rows import PointExchange
from . import Solution, solve_radiosity
from .patch_solution import BURIED, PatchSolution

#: Cosine between normals, and height in sides of a patch, up to which patches count as parts of one surface; and how
#: far away, in the same, a patch may lie that stands for one on which a wall stands.
COPLANAR = 0.9
LEVEL = 0.1
ASIDE = 2.0

#: Buried share above which a patch counts as buried as a whole.
WHOLE = 0.95


@dataclass(kw_only=True)
class MatrixSolution(PatchSolution):
    """Radiosity of fronts and backs by form factors between all of them.

    Parameters beside those of `PatchSolution`
    ------------------------------------------
    polygons : PatchPolygons
        Of the patches, in the unit frame.
    crossed : (P,) bool
        Patches on which a wall stands. A method knows no two sides of a patch, so where one is chosen `hits_to_rows`
        must not tell them apart either: what rays take away next to a receiver is what the method gave it.
    method, solver : str
        Names, or ``auto``.
    factor_accuracy : float
        Error wanted of the worst form factor.
    light_accuracy : float
        Relative error wanted of the light that a receiver gathers.

    Attributes
    ----------
    exchanging : (2P,) bool
        Fronts and backs that are part of the matrix.
    matrix : (n, n) float64
        Form factors between these, in their order: from the parts of them that do not lie in or under something.
    areas : (n,) float64
        Of these parts.
    polygon_factors : FormFactors
        Between their polygons.
    solution : Solution
    """

    polygons: PatchPolygons
    crossed: np.ndarray
    method: str
    solver: str
    factor_accuracy: float
    light_accuracy: float
    exchanging: np.ndarray = field(init=False)
    matrix: np.ndarray = field(init=False)
    areas: np.ndarray = field(init=False)
    polygon_factors: FormFactors = field(init=False)
    solution: Solution = field(init=False)

    def _iterate(self, tolerance: float) -> Generator[float, None, None]:
        yield 0.0
        count = self.patches.count
        self.exchanging = self.active.copy()
        rows = np.flatnonzero(self.exchanging)
        # Lights, the sky, and what shines without taking part: all that reaches the patches other than from each other.
        given = self.given() + self.factors.times(np.where(self.exchanging[:, None], 0, self.emitted))
        sources = (self.emitted + self.reflectances * given)[rows].astype(np.float64)
        environment, owners = self._environment(rows, sources)
        visibility = self._visibility()
        self.polygon_factors = form_factors(
            environment, self.method, visibility, self.factor_accuracy, self.seed, self.pool.threads
        )
        yield 0.8
        self.rays_traced += self.polygon_factors.rays
        matrix = over_patches(self.polygon_factors.matrix, environment.areas, owners, len(rows)).copy()
        free = 1 - self._buried_shares(matrix, rows)
        # A patch half under a block would be half as bright, as that half sees nothing; but its light is wanted where
        # it can be seen. With the free area for the whole, reciprocity stays as it was.
        partly, inside = free < 1, self.enclosed[rows] & (rows >= count)
        matrix[np.ix_(partly, inside)] = matrix[np.ix_(inside, partly)] = 0
        self.matrix, self.areas = matrix / free[:, None], free * np.tile(self.patches.areas, 2)[rows]
        self.solution = solve_radiosity(
            self.matrix, self.reflectances[rows], sources, self.areas, self.solver, tolerance
        )
        self.sweeps, self.residual = self.solution.iterations, self.solution.residual
        self.radiosity = self.emitted
        # What a receiver's near field takes away is what it was given: the same radiosity on both ways.
        self.radiosity[rows] = self._seen_radiosity(rows)
        given[rows] += self.matrix @ self.solution.radiosity
        self.irradiance = given
        if self.method != "auto":
            at_points = METHODS[self.method].at_points
            point_rows = at_points(environment, visibility, self.light_accuracy, self.seed, self.pool.threads)
            self.exchange = PointExchange(point_rows, self.radiosity[rows][owners].astype(np.float64))

    def _buried_shares(self, matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Share (n,) of the fronts and backs numbered `rows` (n,) that lies under or in something, by their factors.

        The insides of solids are part of the matrix, and what sees them is buried. Backs that reflect nothing are not:
        where sample points see hardly anything else, what escapes has met them.
        """
        inside = (rows >= self.patches.count) & self.enclosed[rows]
        shares = matrix[:, inside].sum(axis=1)
        black = np.zeros(len(self.active))
        for side_rows, _, seen, kept in self.gathered_sides():
            met = (seen.rows == self.hits_to_rows.black_row).mean(axis=1).reshape(kept.shape)
            black[side_rows] = (met * (met > BURIED)).mean(axis=1)
        shares += np.minimum(black[rows], np.maximum(1 - matrix.sum(axis=1), 0))
        # What is buried as a whole, or sees the inside of a solid from within, stays so.
        return np.where(inside | (shares > WHOLE), 0, shares)

    def _seen_radiosity(self, rows: np.ndarray) -> np.ndarray:
        """Radiosity (n, 3) of fronts and backs numbered `rows` (n,) as receivers see them.

        A patch at a wall's foot has light of both sides of the wall, or hardly any where most of it lies under a block;
        whoever stands there has half a hemisphere of it. It shows the light of the nearest patch beside it.
        """
        radiosity = self.solution.radiosity.copy()
        patches = self.patches
        mixed = self.buried[rows] | self.crossed[rows % patches.count]
        sound, mixed = np.flatnonzero(~mixed), np.flatnonzero(mixed)
        if not (len(sound) and len(mixed)):
            return radiosity
        front = np.where(rows < patches.count, 1, -1)[:, None]
        places, normals = (a[rows % patches.count] for a in (patches.points.mean(axis=1), patches.normals[:, 0]))
        normals = front * normals
        apart = np.linalg.norm(places[mixed, None] - places[sound], axis=2)
        height = np.abs(np.einsum("msi,mi->ms", places[sound] - places[mixed, None], normals[mixed]))
        beside = (normals[mixed] @ normals[sound].T > COPLANAR) & (height < LEVEL * patches.spacing)
        apart[~beside] = np.inf
        nearest = apart.argmin(axis=1)
        near = np.take_along_axis(apart, nearest[:, None], axis=1)[:, 0] < ASIDE * patches.spacing
        radiosity[mixed[near]] = radiosity[sound[nearest[near]]]
        return radiosity

    def _visibility(self) -> str:
        """The rays that a bake has anyway, where the method takes them."""
        if self.method != "auto" and "embree" in METHODS[self.method].visibilities:
            return "embree"
        return "auto"

    def _environment(self, rows: np.ndarray, sources: np.ndarray) -> tuple[Environment, np.ndarray]:
        """One-sided polygons of the fronts and backs numbered `rows` (n,) that send `sources` (n, 3), and the place
        (k,) of each among them."""
        count = self.patches.count
        place = np.full(2 * count, -1)
        place[rows] = np.arange(len(rows))
        patches, corners = self.polygons.patches, self.polygons.corners
        fronts, backs = (np.flatnonzero(place[patches + side] >= 0) for side in (0, count))
        loops = np.concatenate([corners[fronts], corners[backs][:, ::-1]])
        owners = np.concatenate([place[patches[fronts]], place[count + patches[backs]]])
        with warnings.catch_warnings():
            # Slivers exchange nothing, in this environment as anywhere.
            warnings.simplefilter("ignore")
            environment = Environment.from_polygons(list(loops), self.reflectances[rows][owners], sources[owners])
        return environment, owners

    def looked_up(self) -> np.ndarray:
        """(rows, 4) float32: what is left to rays, the sky and what takes no part in the exchange."""
        if self.exchange is None:
            return self.table()
        return self.hits_to_rows.table(np.where(self.exchanging[:, None], 0, self.radiosity))
