"""Solvers of a matrix of radiosity equations, by name. One module a solver, one signature for all."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from ..errors import SettingsError
from .direct import solve_direct
from .gauss_seidel import solve_gauss_seidel
from .gmres import solve_gmres
from .jacobi import solve_jacobi
from .progressive_refinement import solve_progressive_refinement
from .system import Callback, Solution, System

#: Solvers by name. A solver takes (system, tolerance, max_iterations, start, callback, **options) and returns a
#: `Solution`.
SOLVERS: dict[str, Callable[..., Solution]] = {
    "direct": solve_direct,
    "jacobi": solve_jacobi,
    "gauss_seidel": solve_gauss_seidel,
    "gmres": solve_gmres,
    "progressive_refinement": solve_progressive_refinement,
}

#: Options of solvers that have any.
OPTIONS = {"gmres": ("restart",), "progressive_refinement": ("batch", "absorbed", "time_limit")}

#: Patches up to which ``auto`` eliminates: the result is exact, at a tenth of a second per distinct reflectance column.
#: Beyond, `gmres` is some times faster, the more so the more patches there are.
DIRECT_PATCHES = 1000

#: Sweeps after which gathering solvers end when no limit is given.
SWEEPS = 1000


def solve_radiosity(
    form_factors: np.ndarray,
    reflectance: float | np.ndarray,
    emission: float | np.ndarray,
    areas: np.ndarray | None = None,
    method: str = "direct",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    start: np.ndarray | None = None,
    **options,
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
        ``auto``, or one of `SOLVERS`.
    tolerance : float
        Residual at which iteration ends: the unshot share of the emitted power, in the worst channel.
    max_iterations : int, optional
        Sweeps, or steps of ``progressive_refinement``, after which iteration ends, converged or not. When left out 1000
        sweeps, or as many steps as shoot n patches 1000 times.
    callback : callable, optional
        Called with a `State` after each sweep or step; stops the solver by returning something true.
    start : (n, c) float, optional
        Radiosity to start from, such as the solution before a change; the emission when left out.
    **options
        Of ``progressive_refinement``: ``batch``, ``absorbed``, ``time_limit`` (see `ProgressiveRefinement.refine`); of
        ``gmres``: ``restart``.

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
    check_options(method, options)
    if max_iterations is not None and max_iterations < 0:
        raise SettingsError(f"Maximum iterations must be 0 or more, not {max_iterations}")
    system = System.from_arrays(form_factors, reflectance, emission, areas)
    for message in system.warnings:
        warnings.warn(message, stacklevel=2)
    if method == "auto":
        method = "direct" if len(system.form_factors) <= DIRECT_PATCHES else "gmres"
    if max_iterations is None and method != "progressive_refinement":
        max_iterations = SWEEPS
    return SOLVERS[method](system, tolerance, max_iterations, start, callback, **options)


def check_options(method: str, options: dict) -> None:
    """Raise SettingsError if a solver does not know an option."""
    known = OPTIONS.get(method, ())
    for option in options:
        if option not in known:
            listed = f": choose {', '.join(known)}" if known else ", it has none"
            raise SettingsError(f"Unknown option {option!r} of solver {method}{listed}")
