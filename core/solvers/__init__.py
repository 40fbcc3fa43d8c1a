"""Solvers of the radiosity equations, by name. One module a solver, one signature for all."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..form_factors.matrix import FormFactors
from .direct import solve_direct
from .gauss_seidel import solve_gauss_seidel
from .jacobi import solve_jacobi
from .system import Solution, State, System

#: Solvers by name. A solver takes (system, tolerance, max_iterations, start, callback) and returns a `Solution`.
SOLVERS: dict[str, Callable[..., Solution]] = {
    "direct": solve_direct,
    "jacobi": solve_jacobi,
    "gauss_seidel": solve_gauss_seidel,
}

#: Patches up to which ``auto`` eliminates. 2/3 n^3 operations per distinct reflectance column then cost no more than
#: the 100 or so sweeps of 2 n^2 per channel that bright rooms need, and the result is exact.
DIRECT_PATCHES = 1000


def solve_radiosity(
    form_factors: np.ndarray,
    reflectance: float | np.ndarray,
    emission: float | np.ndarray,
    areas: np.ndarray | None = None,
    method: str = "direct",
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    callback: Callable[[State], None] | None = None,
    start: np.ndarray | None = None,
) -> Solution:
    """Solve ``B = E + reflectance * (F @ B)`` for B, all channels at once.

    Parameters
    ----------
    form_factors : (n, n) float
        Share of the power leaving the row's patch that reaches the column's.
    reflectance : float, (n,) or (n, c)
        Values outside 0 to 1 are clamped, with a warning.
    emission : float, (n,) or (n, c)
        Emitted exitance, 0 or more, in any unit: that of the result.
    areas : (n,) float, optional
        Weights of the residual; equal when left out.
    method : str
        ``auto``, ``direct``, ``jacobi`` or ``gauss_seidel``.
    tolerance : float
        Residual at which iteration ends: the unshot share of the emitted power, in the worst channel.
    max_iterations : int
        Sweeps after which iteration ends, converged or not.
    callback : callable, optional
        Called with a `State` after each sweep.
    start : (n, c) float, optional
        Radiosity to start from, such as the solution before a change; the emission when left out.

    Returns
    -------
    Solution

    Raises
    ------
    SettingsError
        If the method is unknown or a setting is out of range.
    SolverError
        If the system is malformed or has no solution.
    """
    if method != "auto" and method not in SOLVERS:
        raise SettingsError(f"Unknown solver {method!r}: choose auto, {', '.join(SOLVERS)}")
    if not (np.isfinite(tolerance) and tolerance >= 0):
        raise SettingsError(f"Tolerance must be finite and 0 or more, not {tolerance}")
    if max_iterations < 0:
        raise SettingsError(f"Maximum iterations must be 0 or more, not {max_iterations}")
    system = System.from_arrays(form_factors, reflectance, emission, areas)
    for message in system.warnings:
        warnings.warn(message, stacklevel=2)
    if method == "auto":
        method = "direct" if len(system.form_factors) <= DIRECT_PATCHES else "gauss_seidel"
    return SOLVERS[method](system, tolerance, max_iterations, start, callback)


def solve(
    environment: Environment,
    form_factors: FormFactors | np.ndarray,
    method: str = "auto",
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    callback: Callable[[State], None] | None = None,
    start: np.ndarray | None = None,
) -> Solution:
    """Radiosity (n, 3) of an environment's patches; the parameters are those of `solve_radiosity`."""
    matrix = form_factors.matrix if isinstance(form_factors, FormFactors) else form_factors
    return solve_radiosity(
        matrix,
        environment.reflectance,
        environment.emission,
        environment.areas,
        method,
        tolerance,
        max_iterations,
        callback,
        start,
    )


__all__ = ["SOLVERS", "Solution", "State", "System", "solve", "solve_radiosity"]
