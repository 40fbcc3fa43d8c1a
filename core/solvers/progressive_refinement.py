"""Progressive refinement: patches shoot one after the other, the strongest first (survey eq. 15).

Each step takes the patch with most unshot power and adds what it sends to all others. A useful picture is there after
as many steps as there are bright patches, long before a gathering solver has finished its first sweep, and only the
form factors of patches that have shot are ever asked for: choose it where rows are computed on demand, or a rough
solution is enough. To full convergence Krylov's method (`gmres`) is far cheaper.

Cost: a row of form factors and n operations per step; about n / (1 - mean reflectance) steps per factor of ten. With
`batch` several patches shoot at once, in a slightly worse order but in one matrix product.

Bookkeeping is exact to rounding: at each step emitted = absorbed + escaped + unshot power. Work can be interrupted at
any step and continued from the same `ProgressiveRefinement`, or from its saved `ShootingState`, with the same bits as
if it had never stopped. The ambient term estimates what is missing; it is for display only and never added to the
radiosity.

The survey's equation 15 multiplies by the reflectance of the shooting patch; it is the receiver's that counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError, SolverError
from .system import Callback, Quantities, Solution, State, System

#: Sweeps' worth of shots after which it ends when no other limit is given.
SWEEPS = 1000

#: Mean reflectance at most assumed by the ambient term: where nothing absorbs, its series has no sum.
MOST_REFLECTED = 0.999

#: Rows (b, n) of form factors of b patches: the share of the power leaving each that reaches each other.
Rows = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ShootingState:
    """Everything that shooting needs to go on, as arrays of its own; it may be pickled.

    Attributes
    ----------
    radiosity, unshot : (n, c) float64
        `radiosity` includes what is unshot.
    absorbed, escaped : (c,) float64
        Powers so far.
    residuals : (steps + 1,) float64
    shots : int
        Rows of form factors used so far; a patch that shot twice counts twice.
    """

    radiosity: np.ndarray
    unshot: np.ndarray
    absorbed: np.ndarray
    escaped: np.ndarray
    residuals: np.ndarray
    shots: int


class ProgressiveRefinement:
    """A solution by shooting that can be stopped, looked at and refined further.

    Made by `from_matrix` or `from_rows`.

    Parameters
    ----------
    quantities : Quantities
        What the patches emit and reflect.
    columns : callable
        ``columns(patches)`` gives (n, b): radiosity at each patch per unit of each of b patches, before reflection.
    state : ShootingState, optional
        Where to go on; the start, where all emission is unshot, when left out.
    """

    def __init__(
        self, quantities: Quantities, columns: Callable[[np.ndarray], np.ndarray], state: ShootingState | None = None
    ):
        self.quantities = quantities
        self._columns = columns
        self.emitted = quantities.areas @ quantities.emission
        if state is None:
            nothing = np.zeros(quantities.emission.shape[1])
            first = np.array([quantities.residual(quantities.emission)])
            state = ShootingState(quantities.emission, quantities.emission, nothing, nothing, first, 0)
        if state.radiosity.shape != quantities.emission.shape:
            raise SolverError(f"The state is of shape {state.radiosity.shape}, not {quantities.emission.shape}")
        self.radiosity, self.unshot = state.radiosity.copy(), state.unshot.copy()
        self.absorbed, self.escaped = state.absorbed.copy(), state.escaped.copy()
        self.residuals, self.shots = state.residuals.tolist(), state.shots

    @classmethod
    def from_matrix(
        cls, form_factors, reflectance, emission, areas=None, state: ShootingState | None = None
    ) -> ProgressiveRefinement:
        """Shooting through a whole matrix; see `radiosity.core.solve_radiosity` for the arrays."""
        return cls._of_system(System.from_arrays(form_factors, reflectance, emission, areas), state)

    @classmethod
    def _of_system(cls, system, state=None):
        # Columns of the matrix rather than rows by way of reciprocity: the limit is the solution even of a matrix that
        # lacks it, and areas may be left out.
        return cls(system, lambda patches: system.form_factors[:, patches], state)

    @classmethod
    def from_rows(
        cls, rows: Rows, reflectance, emission, areas: np.ndarray, state: ShootingState | None = None
    ) -> ProgressiveRefinement:
        """Shooting through rows of form factors that are asked for when their patch shoots.

        Parameters
        ----------
        rows : callable
            ``rows(patches)`` gives (b, n) for patches (b,) int: their shares of power that reach each other patch.
            See `radiosity.core.form_factors.rows_on_demand`.
        reflectance, emission : float, (n,) or (n, c)
        areas : (n,) float
        state : ShootingState, optional
        """
        areas = np.asarray(areas, dtype=np.float64)
        quantities = Quantities.of_patches(len(areas), reflectance, emission, areas)
        inverse = np.where(areas > 0, 1 / np.where(areas > 0, areas, 1), 0)

        def columns(patches):
            factors = np.asarray(rows(patches), dtype=np.float64)
            if factors.shape != (len(patches), len(areas)):
                raise SolverError(f"Rows must be of shape {(len(patches), len(areas))}, not {factors.shape}")
            if not (np.isfinite(factors) & (factors >= 0)).all():
                bad = patches[~(np.isfinite(factors) & (factors >= 0)).all(axis=1)][0]
                raise SolverError(f"Form factors of patch {bad} are negative or not finite")
            # Survey eq. 15: F_ji = F_ij A_i / A_j.
            return (factors * areas[patches, None]).T * inverse[:, None]

        return cls(quantities, columns, state)

    @classmethod
    def from_environment(
        cls, environment: Environment, rows: Rows, state: ShootingState | None = None
    ) -> ProgressiveRefinement:
        """Shooting through rows on demand between the patches of an environment."""
        return cls.from_rows(rows, environment.reflectance, environment.emission, environment.areas, state)

    def start_from(self, radiosity: np.ndarray, irradiance: np.ndarray) -> None:
        """Begin anew with light (n, c) that counts as shot and has arrived as `irradiance` (n, c).

        What it lacks to a solution is unshot, and may be negative: an edit's light and its shadow are shot alike.
        """
        known = self.quantities
        arrived = known.areas @ irradiance
        self.radiosity = known.emission + known.reflectance * irradiance
        self.unshot = self.radiosity - radiosity
        self.absorbed = known.areas @ ((1 - known.reflectance) * irradiance)
        self.escaped = known.areas @ radiosity - arrived
        self.residuals, self.shots = [known.residual(self.unshot)], 0

    @property
    def state(self) -> ShootingState:
        """A copy of where it stands."""
        return ShootingState(
            self.radiosity.copy(),
            self.unshot.copy(),
            self.absorbed.copy(),
            self.escaped.copy(),
            np.array(self.residuals),
            self.shots,
        )

    @property
    def ambient(self) -> np.ndarray:
        """(c,) irradiance that the unshot light will add on average: survey 2.3.2.

        Unshot power spread evenly over all area, times the sum of its reflections, 1 / (1 - mean reflectance).
        """
        known = self.quantities
        total = known.areas.sum()
        if not total > 0:
            return np.zeros(self.unshot.shape[1])
        reflected = np.minimum(known.areas @ known.reflectance / total, MOST_REFLECTED)
        return (known.areas @ self.unshot) / total / (1 - reflected)

    def displayed(self) -> np.ndarray:
        """(n, c) radiosity to show: with the ambient term, ``B' = B + reflectance * ambient``."""
        return self.radiosity + self.quantities.reflectance * self.ambient

    def absorbed_share(self) -> float:
        """Share of the light not gone that patches have absorbed, in the worst channel; 1 in darkness."""
        staying = self.absorbed + self.quantities.areas @ np.abs(self.unshot)
        shares = np.where(staying > 0, self.absorbed / np.where(staying > 0, staying, 1), 1)
        return float(shares.min(initial=1))

    def refine(
        self,
        tolerance: float = 1e-6,
        max_iterations: int | None = None,
        absorbed: float | None = None,
        time_limit: float | None = None,
        batch: int = 1,
        callback: Callback | None = None,
    ) -> Solution:
        """Shoot until one of the limits is reached, from where it stands.

        Parameters
        ----------
        tolerance : float
            Unshot share of the emitted power, in the worst channel.
        max_iterations : int, optional
            Steps of `batch` shots in this call.
        absorbed : float, optional
            Share of the light that stays in the scene, such as 0.99, at whose absorption it ends, in the worst channel.
        time_limit : float, optional
            Seconds after which no further step begins; at least one is done.
        batch : int
            Patches that shoot at once.
        callback : callable, optional
            Called with a `State` after each step; stops by returning something true.

        Returns
        -------
        Solution
            `iterations` and `residuals` count all steps since the start, not those of this call alone.

        Raises
        ------
        SettingsError
            If a limit is out of range.
        SolverError
            If rows are malformed, or sum to so much more than 1 that light grows without end.

        References
        ----------
        .. [1] Cohen, Chen, Wallace, Greenberg, "A Progressive Refinement Approach to Fast Radiosity Image Generation",
           SIGGRAPH 1988.
        """
        _check_limits(tolerance, max_iterations, absorbed, time_limit, batch)
        known, count = self.quantities, len(self.radiosity)
        if max_iterations is None:
            max_iterations = SWEEPS * -(-count // batch)
        begin, last = time.perf_counter(), len(self.residuals) + max_iterations
        ended_by = ""
        while not ended_by:
            if self.residuals[-1] <= tolerance:
                ended_by = "tolerance"
            elif absorbed is not None and self.absorbed_share() >= absorbed:
                ended_by = "absorbed"
            elif len(self.residuals) >= last:
                ended_by = "max_iterations"
            elif (
                time_limit is not None
                and len(self.residuals) > last - max_iterations
                and (time.perf_counter() - begin >= time_limit)
            ):
                ended_by = "time_limit"
            else:
                shooters = self._shoot(batch)
                if callback is not None and callback(self._seen_by_callback(shooters)):
                    ended_by = "callback"
        return Solution(
            radiosity=self.radiosity[:, 0].copy() if known.flat else self.radiosity.copy(),
            method="progressive_refinement",
            iterations=len(self.residuals) - 1,
            residual=self.residuals[-1],
            residuals=np.array(self.residuals),
            converged=self.residuals[-1] <= tolerance,
            warnings=tuple(known.warnings),
            ended_by=ended_by,
        )

    def _shoot(self, batch: int) -> np.ndarray:
        """One step: the patches that shot, strongest first."""
        known = self.quantities
        shooters = self._strongest(batch)
        sent = self.unshot[shooters]
        # Running away is told below, by name.
        with np.errstate(over="ignore", invalid="ignore"):
            arriving = self._columns(shooters) @ sent
            self.unshot[shooters] = 0
            reflected = known.reflectance * arriving
            self.radiosity += reflected
            self.unshot += reflected
            self.absorbed += known.areas @ (arriving - reflected)
            self.escaped += known.areas[shooters] @ sent - known.areas @ arriving
        self.shots += len(shooters)
        self.residuals.append(known.residual(self.unshot))
        if not np.isfinite(self.residuals[-1]):
            raise SolverError("progressive_refinement runs away: rows of form factors sum to more than 1")
        return shooters

    def _strongest(self, batch: int) -> np.ndarray:
        """Patches with most unshot power, ties to the lowest index.

        Channels count by their share of the emitted power, the norm in which solutions are judged: a faint channel
        shall not wait for a bright one.
        """
        scale = np.where(self.emitted > 0, self.emitted, max(self.emitted.max(initial=0), np.finfo(np.float64).tiny))
        power = self.quantities.areas * (np.abs(self.unshot) @ (1 / scale))
        if batch == 1:
            return power.argmax(keepdims=True)
        if batch < len(power):
            # The lowest index among equals, also across the border of the batch.
            least = np.partition(power, -batch)[-batch]
            chosen = np.flatnonzero(power >= least)
            return chosen[np.argsort(-power[chosen], kind="stable")][:batch]
        return np.argsort(-power, kind="stable")

    def _seen_by_callback(self, shooters):
        return State(
            iteration=len(self.residuals) - 1,
            radiosity=self.radiosity,
            unshot=self.unshot,
            residual=self.residuals[-1],
            ambient=self.ambient,
            shooter=int(shooters[0]),
            shooters=shooters,
            absorbed=self.absorbed,
            escaped=self.escaped,
        )


def _check_limits(tolerance, max_iterations, absorbed, time_limit, batch):
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise SettingsError(f"Tolerance must be finite and 0 or more, not {tolerance}")
    if max_iterations is not None and max_iterations < 0:
        raise SettingsError(f"Maximum iterations must be 0 or more, not {max_iterations}")
    if absorbed is not None and not 0 < absorbed <= 1:
        raise SettingsError(f"Share of light to be absorbed must lie above 0 and be at most 1, not {absorbed}")
    if time_limit is not None and not time_limit >= 0:
        raise SettingsError(f"Time limit must be 0 or more seconds, not {time_limit}")
    if batch != int(batch) or batch < 1:
        raise SettingsError(f"Patches that shoot at once must be 1 or more, not {batch}")


def solve_progressive_refinement(
    system: System,
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    start: np.ndarray | None = None,
    callback: Callback | None = None,
    **limits,
) -> Solution:
    """Solve by shooting; see `radiosity.core.solve_radiosity` and `ProgressiveRefinement.refine` for the parameters."""
    refinement = ProgressiveRefinement._of_system(system)
    if start is not None:
        start = system.begin(start)
        refinement.start_from(start, system.form_factors @ start)
    return refinement.refine(tolerance, max_iterations, callback=callback, **limits)
