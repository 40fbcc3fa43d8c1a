"""The radiosity equations ``B = E + reflectance * (F @ B)`` of all channels, checked, and what solvers say about them.

The norm that all solvers state is the *unshot share*: the area-weighted sum of ``|E + reflectance * (F @ B) - B|``, the
power that still waits to be sent on, over the emitted power, in the worst channel. The power still missing from the
solution is at most the residual over 1 minus the largest reflectance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..environment import clamp_reflectance
from ..errors import SettingsError, SolverError


@dataclass(frozen=True)
class State:
    """A solution on its way, handed to callbacks after each step. Arrays are (n, c) and valid during the call only.

    `unshot` is the radiosity still to be sent on. Solvers that shoot also tell the patches `shooters` (b,) that have
    just sent, strongest first, of which `shooter` is the first; `ambient` (c,), the estimate of what the unshot light
    will add to the irradiance on average; and the powers (c,) `absorbed` and `escaped` so far. These are None else.
    A callback that returns something true stops the solver there.
    """

    iteration: int
    radiosity: np.ndarray
    unshot: np.ndarray
    residual: float
    ambient: np.ndarray | None = None
    shooter: int | None = None
    shooters: np.ndarray | None = None
    absorbed: np.ndarray | None = None
    escaped: np.ndarray | None = None


#: Called after each step; stops the solver by returning something true.
Callback = Callable[[State], object]


@dataclass(frozen=True)
class Solution:
    """Radiosity and how it was found.

    Attributes
    ----------
    radiosity : (n, c) float64
        Exitance of each patch; (n,) when emission and reflectance came without channels.
    method : str
    iterations : int
        Sweeps done, or steps of a solver that shoots; 0 for a direct solution.
    residual : float
        Unshot share of the emitted power, in the worst channel (see the module).
    residuals : (iterations + 1,) float64
        The residual before the first sweep and after each.
    converged : bool
        Whether `residual` is at most the tolerance.
    warnings : tuple of str
    ended_by : str
        What stopped it: ``tolerance``, ``max_iterations``, ``callback``, ``absorbed`` or ``time_limit``.
    """

    radiosity: np.ndarray
    method: str
    iterations: int
    residual: float
    residuals: np.ndarray
    converged: bool
    warnings: tuple[str, ...] = ()
    ended_by: str = "tolerance"


@dataclass(frozen=True)
class Quantities:
    """What n patches emit and reflect in c channels, and their areas; made by `of_patches`, which checks them."""

    reflectance: np.ndarray  # (n, c)
    emission: np.ndarray  # (n, c)
    areas: np.ndarray  # (n,)
    flat: bool  # whether the caller gave no channels
    warnings: list[str]

    @classmethod
    def of_patches(cls, count: int, reflectance, emission, areas=None) -> Quantities:
        """Check and broadcast.

        Raises
        ------
        SolverError
            If shapes do not match.
        SettingsError
            If a reflectance is not a number, or an emission is negative or not finite.
        """
        reflectance = _columns("Reflectance", reflectance, count)
        emission = _columns("Emission", emission, count)
        flat = reflectance.ndim == 1 and emission.ndim == 1
        reflectance, emission = (a[:, None] if a.ndim == 1 else a for a in (reflectance, emission))
        try:
            reflectance, emission = (a.copy() for a in np.broadcast_arrays(reflectance, emission))
        except ValueError:
            raise SolverError(
                f"Reflectance has {reflectance.shape[1]} channels and emission {emission.shape[1]}: give both the same"
            ) from None
        if not (np.isfinite(emission) & (emission >= 0)).all():
            row = int(np.flatnonzero(~(np.isfinite(emission) & (emission >= 0)).all(axis=1))[0])
            raise SettingsError(f"Emission of patch {row} must be finite and 0 or more")
        areas = np.ones(count) if areas is None else np.asarray(areas, dtype=np.float64)
        if areas.shape != (count,) or not (np.isfinite(areas) & (areas >= 0)).all():
            raise SolverError(f"Areas must be {count} numbers, finite and 0 or more")
        messages: list[str] = []
        reflectance = clamp_reflectance(reflectance, messages)
        return Quantities(reflectance, emission, areas, flat, messages)

    def residual(self, unshot: np.ndarray) -> float:
        """Unshot share of the emitted power, in the worst channel."""
        emitted = self.areas @ self.emission
        waiting = self.areas @ np.abs(unshot)
        # A channel without emission is measured by the brightest one, and darkness by nothing.
        scale = np.where(emitted > 0, emitted, emitted.max(initial=0))
        shares = waiting / np.where(scale > 0, scale, 1)
        return float(shares.max(initial=0))


@dataclass(frozen=True)
class System(Quantities):
    """The equations of n patches in c channels; made by `from_arrays`, which checks them."""

    form_factors: np.ndarray  # (n, n)

    @classmethod
    def from_arrays(cls, form_factors, reflectance, emission, areas=None) -> System:
        """Check and broadcast.

        Raises
        ------
        SolverError
            If the matrix is not square, has entries that are negative or not finite, or shapes do not match.
        SettingsError
            If a reflectance is not a number, or an emission is negative or not finite.
        """
        matrix = np.asarray(form_factors, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise SolverError(f"Form factors must be a square matrix, not of shape {matrix.shape}")
        if not (np.isfinite(matrix).all() and (matrix >= 0).all()):
            row = int(np.flatnonzero(~(np.isfinite(matrix) & (matrix >= 0)).all(axis=1))[0])
            raise SolverError(f"Form factors of patch {row} are negative or not finite: compute them again")
        known = Quantities.of_patches(len(matrix), reflectance, emission, areas)
        return cls(known.reflectance, known.emission, known.areas, known.flat, known.warnings, matrix)

    def gather(self, radiosity: np.ndarray) -> np.ndarray:
        """Right side of the equations (n, c) for a given radiosity (n, c)."""
        return self.emission + self.reflectance * (self.form_factors @ radiosity)

    def begin(self, start: np.ndarray | None) -> np.ndarray:
        """A start (n, c) of one's own: a checked copy of the caller's, or the emission.

        Raises
        ------
        SolverError
            If it is not finite or has another shape.
        """
        radiosity = self.emission.copy() if start is None else np.array(start, dtype=np.float64)
        if radiosity.ndim == 1:
            radiosity = radiosity[:, None]
        if radiosity.shape != self.emission.shape or not np.isfinite(radiosity).all():
            raise SolverError(f"The start must be finite and of shape {self.emission.shape}, not {radiosity.shape}")
        return radiosity


def _columns(label: str, values, count: int) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim == 0:
        return np.full(count, float(values))
    if values.ndim in (1, 2) and len(values) == count:
        return values
    raise SolverError(f"{label} must be one number, ({count},) or ({count}, channels), not of shape {values.shape}")


def iterate(
    system: System,
    sweep: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    method: str,
    tolerance: float,
    max_iterations: int,
    start: np.ndarray | None,
    callback: Callback | None,
) -> Solution:
    """Sweep until the residual is at most `tolerance`, or `max_iterations` are done.

    ``sweep(radiosity, unshot)`` returns the next radiosity and its unshot part, both (n, c).

    Raises
    ------
    SolverError
        If the iteration runs away, as it may when rows of form factors sum to more than 1.
    """
    radiosity = system.begin(start)
    unshot = system.gather(radiosity) - radiosity
    residuals, stopped = [system.residual(unshot)], False
    while not stopped and residuals[-1] > tolerance and len(residuals) <= max_iterations:
        radiosity, unshot = sweep(radiosity, unshot)
        residuals.append(system.residual(unshot))
        if not np.isfinite(residuals[-1]):
            raise SolverError(
                f"{method} runs away after {len(residuals) - 1} sweeps: rows of form factors sum to more than 1"
            )
        if callback is not None:
            stopped = bool(callback(State(len(residuals) - 1, radiosity, unshot, residuals[-1])))
    return Solution(
        radiosity=radiosity[:, 0] if system.flat else radiosity,
        method=method,
        iterations=len(residuals) - 1,
        residual=residuals[-1],
        residuals=np.array(residuals),
        converged=residuals[-1] <= tolerance,
        warnings=tuple(system.warnings),
        ended_by="tolerance" if residuals[-1] <= tolerance else "callback" if stopped else "max_iterations",
    )
