"""One entrance to all ways of solving an environment: by its matrix, by rows on demand, or by dividing its surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..form_factors.matrix import FormFactors
from .adaptive import solve_adaptively
from .black_boundary import black_boundary
from .choice import SOLVERS, check_options, solve_radiosity
from .progressive_refinement import ProgressiveRefinement, Rows
from .system import Callback, Solution
from .transparent_boundary import transparent_boundary
from .two_level import two_level

#: Strategies by name that divide surfaces into patches and elements.
DIVISIONS: dict[str, Callable[..., Solution]] = {
    "two_level": two_level,
    "adaptive": solve_adaptively,
}
#: Strategies by name that divide an environment's patches among local environments.
LOCAL_ENVIRONMENTS: dict[str, Callable[..., Solution]] = {
    "black_boundary": black_boundary,
    "transparent_boundary": transparent_boundary,
}
#: Strategies by name, which compute the form factors that they need. A strategy takes (environment, tolerance,
#: max_iterations, callback, **choices) and returns a `Solution`.
STRATEGIES: dict[str, Callable[..., Solution]] = DIVISIONS | LOCAL_ENVIRONMENTS


def solve(
    environment: Environment,
    form_factors: FormFactors | np.ndarray | Rows | None = None,
    method: str = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    start: np.ndarray | None = None,
    **options,
) -> Solution:
    """Radiosity (n, 3) of an environment's patches; the parameters are those of `solve_radiosity`.

    Instead of a matrix a function may be given that computes rows on demand, ``rows(patches) -> (b, n)``, such as from
    `form_factors.rows_on_demand`; then the method is ``progressive_refinement``, which ``auto`` takes. Without form
    factors the method is one of `STRATEGIES`, whose options follow.

    Raises
    ------
    SettingsError
        If the method is unknown or does not suit what is given, or a setting is out of range.
    SolverError
        If the system is malformed or has no solution.
    """
    if method in STRATEGIES:
        if form_factors is not None or start is not None:
            raise SettingsError(f"Strategy {method!r} makes its own patches and form factors: give none, and no start")
        return STRATEGIES[method](environment, tolerance=tolerance, max_iterations=max_iterations, callback=callback,
                                  **options)  # fmt: skip
    if method != "auto" and method not in SOLVERS:
        raise SettingsError(f"Unknown solver {method!r}: choose auto, {', '.join([*SOLVERS, *STRATEGIES])}")
    if form_factors is None:
        raise SettingsError(f"Solver {method!r} needs form factors: give them, or choose {', '.join(STRATEGIES)}")
    if callable(form_factors):
        if method not in ("auto", "progressive_refinement"):
            raise SettingsError(f"Solver {method!r} needs a whole matrix, not rows: choose progressive_refinement")
        if start is not None:
            raise SettingsError("A start needs a whole matrix: go on from a ProgressiveRefinement's state instead")
        check_options("progressive_refinement", options)
        refinement = ProgressiveRefinement.from_environment(environment, form_factors)
        return refinement.refine(tolerance, max_iterations, callback=callback, **options)
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
        **options,
    )
