"""Black boundaries: cells are solved in turn, and portals emit what arrived on their other side (survey 3, [11]).

To its own cell a portal is a black patch that emits. What it emits is what the cell behind has sent to it, as of the
last time that this one was solved; when all cells have had their turn, the first begins again (Neumann's method, block
Gauss-Seidel). A sweep goes through the cells and back, so that light from the last room reaches the first as fast as
the other way round; where bright rooms exchange much, Anderson's acceleration makes of the last sweeps what hundreds
would come to. No system is ever larger than a cell's.

Choose it for many rooms and small doors. A portal forgets where light came from, and how it was spread over its area:
it emits diffusely. So the light beyond is right in its amount and wrong in its pattern. That error does not vanish with
smaller portals; it is estimated by the residual of the solution under transparent factors (`transparent_boundary`),
made good by a solution of these, and reported.

Cost: the cells' matrices; 20 to 60 products with each for a sweep, of which there are three to twenty. The estimate
costs lines through doorways and a transparent solution from there; ``estimate=False`` leaves it out, and with it the
need for the ray engine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..discretization.local_environments import Partition, partition
from ..environment import Environment
from ..errors import SettingsError
from .anderson import MEMORY, mixed
from .cell_factors import CellFactors, cell_factors
from .choice import SOLVERS, SWEEPS, solve_radiosity
from .system import Callback, Quantities, Solution, System, iterate
from .transparent_boundary import (
    STANDARD_ERRORS,
    LocalSolution,
    check_partition,
    check_solving,
    relative_error,
    solve_transparent,
    transparent_factors,
)

#: Part of the residual allowed that the cells' own solutions may leave, all together.
CELL_SHARE = 0.25

#: Share of its area by which a patch's part in a cell may miss it and count as whole: the roundings of cutting.
WHOLE = 1e-9

#: Steps of a cell's solver, in one turn.
CELL_STEPS = 200


class BlackFactors:
    """Form factors of n patches and 2 p portal sides as a product: ``factors @ radiosity`` is irradiance (n + 2 p, c).

    What arrives on one side of a portal is counted on the other, which emits it.

    Parameters
    ----------
    areas : (n,) float
        Radiating areas of the patches.
    cells : list of CellFactors
    portals : int
    """

    def __init__(self, areas: np.ndarray, cells: list[CellFactors], portals: int):
        count = len(areas)
        self.size = count + 2 * portals
        self.members, self.targets, self.matrices = [], [], []
        for cell in cells:
            whole = np.where(areas[cell.patches] > 0, areas[cell.patches], 1)
            shares = np.concatenate((cell.areas[: len(cell.patches)] / whole, np.ones(len(cell.sides))))
            # Parts of cut patches receive for their share of the patch.
            cut = (np.abs(shares - 1) > WHOLE).any()
            self.members.append(np.concatenate((cell.patches, count + cell.sides)))
            self.targets.append(np.concatenate((cell.patches, count + (cell.sides ^ 1))))
            self.matrices.append(shares[:, None] * cell.matrix if cut else cell.matrix)

    def __matmul__(self, radiosity: np.ndarray) -> np.ndarray:
        arriving = np.zeros_like(radiosity)
        for members, targets, matrix in zip(self.members, self.targets, self.matrices, strict=True):
            arriving[targets] += matrix @ radiosity[members]
        return arriving


def black_boundary(
    environment: Environment,
    cells: Partition | None = None,
    solver: str = "gmres",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    factor_method: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    estimate: bool = True,
    **choices,
) -> LocalSolution:
    """Solve cell after cell until what portals emit has settled.

    Parameters
    ----------
    environment : Environment
        The patches.
    cells : Partition, optional
        Of this environment, such as by `cut_at`; found by `partition` where left out.
    solver : str
        For each cell; a name of `SOLVERS`.
    tolerance, max_iterations, callback
        As in `radiosity.core.solve_radiosity`; iterations are sweeps through all cells; portals count as
        patches.
    factor_method : str
        ``method`` of the form factors inside cells.
    accuracy, seed, threads, **choices
        Of the form factors, and ``workers``, as in `cell_factors`.
    estimate : bool
        Whether to estimate the error that black portals make.

    Returns
    -------
    LocalSolution

    Raises
    ------
    SettingsError
        If a name is unknown, a value out of range, or the partition one of another environment.
    MissingRayEngineError
        If the error is to be estimated, and rays cannot be traced on this platform.

    References
    ----------
    .. [1] Neumann, Neumann, "Photosimulation: Interreflection with Arbitrary Reflectance Models and Illumination",
       Computer Graphics Forum 8(1), 1989.
    """
    check_solving(tolerance, max_iterations)
    if solver not in SOLVERS:
        raise SettingsError(f"Unknown solver {solver!r}: choose {', '.join(SOLVERS)}")
    cells = partition(environment) if cells is None else check_partition(cells, environment)
    factors = cell_factors(cells, factor_method, accuracy=accuracy, seed=seed, threads=threads, **choices)
    solution = solve_black(cells, factors, solver, tolerance, max_iterations, callback)
    found = LocalSolution(**vars(solution), partition=cells)
    if not estimate:
        return found
    joined = transparent_factors(cells, factors, accuracy, seed, threads)
    seen = solve_transparent(environment, joined, tolerance, start=solution.radiosity).radiosity
    errors = np.abs(seen - solution.radiosity)
    errors += STANDARD_ERRORS * environment.reflectance * joined.standard_errors(seen)
    return replace(found, errors=errors, estimated_error=relative_error(environment, errors, seen))


def solve_black(
    cells: Partition,
    factors: list[CellFactors],
    solver: str = "gmres",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
) -> Solution:
    """Solution by turns of the cells, from their factors."""
    environment = cells.environment
    count = len(environment)
    sides = np.zeros((0 if cells.portals is None else 2 * len(cells.portals), 3))
    areas = np.zeros(0) if cells.portals is None else np.repeat(cells.portals.areas, 2)
    known = Quantities.of_patches(
        count + len(sides),
        np.concatenate((environment.reflectance, sides + 1)),
        np.concatenate((environment.emission, sides)),
        np.concatenate((environment.areas, areas)),
    )
    system = System(**vars(known), form_factors=BlackFactors(environment.areas, factors, len(sides) // 2))
    turns = _Turns(system, count, solver, tolerance)

    def patches_only(state):
        return callback(replace(state, radiosity=state.radiosity[:count], unshot=state.unshot[:count]))

    solution = iterate(
        system,
        turns.sweep,
        "black_boundary",
        tolerance,
        SWEEPS if max_iterations is None else max_iterations,
        None,
        patches_only if callback is not None else None,
    )
    return replace(solution, radiosity=solution.radiosity[:count])


class _Turns:
    """Sweeps through all cells, forward and back again, each mixed with those before."""

    def __init__(self, system: System, count: int, solver: str, tolerance: float):
        self.system, self.factors = system, system.form_factors
        self.solver, self.tolerance = solver, tolerance
        self.count = count
        cells = list(range(len(self.factors.matrices)))
        self.order = cells + cells[-2::-1]
        self.steps: list[np.ndarray] = []
        self.changes: list[np.ndarray] = []
        # What portals emit is known in their cells: there they reflect nothing.
        self.reflectance = system.reflectance.copy()
        self.reflectance[count:] = 0
        emitted = system.areas @ system.emission
        self.emitted = np.where(emitted > 0, emitted, emitted.max(initial=0))

    def sweep(self, radiosity, unshot):
        image = radiosity.copy()
        arriving = self.factors @ image
        for cell in self.order:
            self._solve(cell, image, arriving)
        image[self.count :] = arriving[self.count :]
        self.steps.append(image)
        self.changes.append(image - radiosity)
        del self.steps[:-MEMORY], self.changes[:-MEMORY]
        radiosity = mixed(self.steps, self.changes)
        return radiosity, self.system.gather(radiosity) - radiosity

    def _solve(self, cell, radiosity, arriving):
        """Solve a cell for its patches, which changes their radiosity and what arrives at its targets."""
        members, targets = self.factors.members[cell], self.factors.targets[cell]
        matrix = self.factors.matrices[cell]
        if not len(members):
            return
        before = matrix @ radiosity[members]
        portal = members >= self.count
        radiosity[members[portal]] = arriving[members[portal]]
        # Parts of its patches in other cells receive what they did; rounding must not make that negative.
        elsewhere = np.where(portal[:, None], 0, np.maximum(arriving[members] - before, 0))
        reflectance, areas = self.reflectance[members], self.system.areas[members]
        emission = np.where(
            portal[:, None], radiosity[members], self.system.emission[members] + reflectance * elsewhere
        )
        radiosity[members] = solve_radiosity(
            matrix,
            reflectance,
            emission,
            areas,
            self.solver,
            self._tolerance(areas @ emission),
            CELL_STEPS,
            start=radiosity[members],
        ).radiosity
        arriving[targets] += matrix @ radiosity[members] - before

    def _tolerance(self, power):
        """Residual allowed in a cell of some power (c,), so that all cells together keep to theirs."""
        lit = (power > 0) & (self.emitted > 0)
        share = (self.emitted[lit] / power[lit]).min(initial=1)
        return CELL_SHARE * self.tolerance * share / len(self.factors.matrices)
