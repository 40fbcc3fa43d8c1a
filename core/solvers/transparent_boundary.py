"""Transparent boundaries: patches of all cells in one system, factors joined at the portals (survey section 3, [17]).

Inside a cell factors are those of the cell by itself (`cell_factors`); between cells they are factors to the portals
times the share of that light which goes on to each patch beyond (`portal_exchange`). The system is solved as a whole by
`gmres`, without a matrix of all patches: a product costs the cells' matrices and the pairs that doorways join.

Choose it where light through doorways matters in its direction: a lamp's shaft on the floor next door. Its sibling
`black_boundary` needs no system of all patches and forgets the direction at each portal.

Cost: in time and memory the cells' matrices, and the pairs joined, which grow with the number of rooms alone, as long
as each sees as many others. Limits: those of the factors inside cells, and of lines through doorways; the estimated
error counts both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..discretization.local_environments import Partition, partition
from ..environment import Environment
from ..errors import SettingsError
from .cell_factors import CellFactors, cell_factors
from .choice import SWEEPS
from .gmres import solve_gmres
from .portal_exchange import PortalExchange, exchange_through_portals
from .system import Callback, Quantities, Solution, System

#: Standard errors that a stated error holds.
STANDARD_ERRORS = 2


@dataclass(frozen=True)
class LocalSolution(Solution):
    """A solution by local environments.

    Attributes
    ----------
    partition : Partition
    errors : (n, c) float64
        Of each patch's radiosity: two standard errors, and what black portals add to them.
    estimated_error : float
        Area-weighted mean of `errors` over that of the reflected light, in the worst channel. NaN where no estimate
        was asked for.
    """

    partition: Partition | None = None
    errors: np.ndarray | None = None
    estimated_error: float = np.nan


class TransparentFactors:
    """Form factors of n patches as a product: ``factors @ radiosity`` is the irradiance (n, c).

    Parameters
    ----------
    areas : (n,) float
        Radiating areas of the patches.
    cells : list of CellFactors
    exchange : PortalExchange or None
        None where no cell is open to another.
    """

    def __init__(self, areas: np.ndarray, cells: list[CellFactors], exchange: PortalExchange | None):
        self.areas = np.where(areas > 0, areas, 1)
        self.cells, self.exchange = cells, exchange

    def __matmul__(self, radiosity: np.ndarray) -> np.ndarray:
        power = np.zeros_like(radiosity) if self.exchange is None else self.exchange.times(radiosity)
        for cell in self.cells:
            count = len(cell.patches)
            arriving = cell.matrix[:count, :count] @ radiosity[cell.patches]
            power[cell.patches] += cell.areas[:count, None] * arriving
        return power / self.areas[:, None]

    def standard_errors(self, radiosity: np.ndarray) -> np.ndarray:
        """Standard error (n, c) of the irradiance: by lines that are few, and by the factors inside cells.

        A factor's error is that of a share of N rays, ``F (1 - F) / N``, where N is such that the worst of a row has
        the error that its method tells. Then errors matter as far as what a patch sees differs from its mean.
        """
        variances = np.zeros_like(radiosity) if self.exchange is None else self.exchange.variances(radiosity)
        emitted = self._emitted_by_portals(radiosity)
        for cell in self.cells:
            count = len(cell.patches)
            factors = cell.matrix[:count]
            seen = np.concatenate((radiosity[cell.patches], emitted[cell.sides]))
            spread = np.maximum(factors @ seen**2 - (factors @ seen) ** 2, 0)
            worst = (factors * (1 - factors)).max(axis=1, initial=0)[:, None]
            per_ray = cell.error**2 / np.where(worst > 0, worst, 1)
            variances[cell.patches] += cell.areas[:count, None] ** 2 * per_ray * spread
        return np.sqrt(variances) / self.areas[:, None]

    def _emitted_by_portals(self, radiosity):
        """Mean radiosity (2 p, c) that portal sides show to their cells, of patches up to two cells away."""
        emitted = np.zeros(
            (1 + max((cell.sides.max(initial=-1) for cell in self.cells), default=-1), radiosity.shape[1])
        )
        emitted = np.concatenate((emitted, emitted[: len(emitted) % 2]))
        for _ in range(2):
            before = emitted.copy()
            for cell in self.cells:
                seen = np.concatenate((radiosity[cell.patches], before[cell.sides]))
                emitted[cell.sides ^ 1] = cell.matrix[len(cell.patches) :] @ seen
        return emitted


def transparent_boundary(
    environment: Environment,
    cells: Partition | None = None,
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    factor_method: str = "auto",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    **choices,
) -> LocalSolution:
    """Solve all cells at once.

    Parameters
    ----------
    environment : Environment
        The patches.
    cells : Partition, optional
        Of this environment, such as by `cut_at`; found by `partition` where left out.
    tolerance, max_iterations, callback
        As in `radiosity.core.solve_radiosity`.
    factor_method : str
        ``method`` of the form factors inside cells.
    accuracy, seed, threads, **choices
        Of the form factors, and ``workers``, as in `cell_factors`. `accuracy` holds for factors through doorways too.

    Returns
    -------
    LocalSolution

    Raises
    ------
    SettingsError
        If a name is unknown, a value out of range, or the partition one of another environment.
    MissingRayEngineError
        If cells are open to each other, and rays cannot be traced on this platform.

    References
    ----------
    .. [1] Xu, Peng, Liang, "Accelerated Radiosity Method for Complex Environments", Eurographics 1989.
    """
    check_solving(tolerance, max_iterations)
    cells = partition(environment) if cells is None else check_partition(cells, environment)
    factors = cell_factors(cells, factor_method, accuracy=accuracy, seed=seed, threads=threads, **choices)
    joined = transparent_factors(cells, factors, accuracy, seed, threads)
    solution = solve_transparent(environment, joined, tolerance, max_iterations, callback)
    errors = STANDARD_ERRORS * environment.reflectance * joined.standard_errors(solution.radiosity)
    return LocalSolution(
        **vars(solution) | {"method": "transparent_boundary"},
        partition=cells,
        errors=errors,
        estimated_error=relative_error(environment, errors, solution.radiosity),
    )


def transparent_factors(
    cells: Partition, factors: list[CellFactors], accuracy: float, seed: int = 0, threads: int = 0
) -> TransparentFactors:
    """Factors of a partition's cells, joined at its portals."""
    exchange = None
    if cells.portals is not None:
        exchange = exchange_through_portals(cells, factors, accuracy, seed, threads)
    return TransparentFactors(cells.environment.areas, factors, exchange)


def solve_transparent(
    environment: Environment,
    factors: TransparentFactors,
    tolerance: float,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    start: np.ndarray | None = None,
) -> Solution:
    """Solution of the whole system by its products."""
    known = Quantities.of_patches(len(environment), environment.reflectance, environment.emission, environment.areas)
    system = System(**vars(known), form_factors=factors)
    return solve_gmres(system, tolerance, SWEEPS if max_iterations is None else max_iterations, start, callback)


def relative_error(environment: Environment, errors: np.ndarray, radiosity: np.ndarray) -> float:
    """Area-weighted mean of errors (n, c) over that of the reflected light, in the worst channel that is lit."""
    reflected = environment.areas @ np.maximum(radiosity - environment.emission, 0)
    missing = environment.areas @ errors
    return float((missing / np.where(reflected > 0, reflected, np.inf)).max(initial=0))


def check_partition(cells: Partition, environment: Environment) -> Partition:
    """The partition, if it is one of this environment.

    Raises
    ------
    SettingsError
        If it is not.
    """
    if cells.environment is not environment:
        raise SettingsError("The cells belong to another environment: cut this one")
    return cells


def check_solving(tolerance: float, max_iterations: int | None) -> None:
    """Raise SettingsError unless tolerance and iterations make sense; before factors are computed, which takes long."""
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise SettingsError(f"Tolerance must be finite and 0 or more, not {tolerance}")
    if max_iterations is not None and max_iterations < 0:
        raise SettingsError(f"Maximum iterations must be 0 or more, not {max_iterations}")
