"""Direct: the full matrix solved by elimination (survey eq. 2).

Exact to rounding, whatever the reflectance, and one elimination serves all channels with equal reflectances. Costs
2/3 n^3 operations and a second matrix: the choice for up to some thousand patches.
"""

from __future__ import annotations

import numpy as np

from ..errors import SolverError
from .system import Solution, System

#: Largest residual of a direct solution. Elimination is backward stable, to about n times 1e-16; light trapped in a
#: closed room of reflectance 1 has no solution, and shows by missing this.
SINGULAR = 1e-6


def solve_direct(system: System, tolerance: float = 1e-6, max_iterations=0, start=None, callback=None) -> Solution:
    """Solve by elimination; `tolerance` only judges the result, and the other parameters are not needed.

    Raises
    ------
    SolverError
        If the equations have no solution: emission inside a closed environment that absorbs nothing.

    References
    ----------
    .. [1] Goral, Torrance, Greenberg, Battaile, "Modeling the Interaction of Light between Diffuse Surfaces",
       SIGGRAPH 1984.
    """
    columns, channels = np.unique(system.reflectance, axis=1, return_inverse=True)
    radiosity = np.empty_like(system.emission)
    for i, reflectance in enumerate(columns.T):
        chosen = np.ravel(channels) == i
        emission = system.emission[:, chosen]
        matrix = -reflectance[:, None] * system.form_factors
        matrix[np.diag_indices_from(matrix)] += 1
        try:
            radiosity[:, chosen] = np.linalg.solve(matrix, emission)
        except np.linalg.LinAlgError:
            radiosity[:, chosen] = 0 if not emission.any() else np.nan
    # Elimination leaves zeros of either sign and rounding below them.
    unshot = system.gather(radiosity) - radiosity
    residual = system.residual(unshot) if np.isfinite(radiosity).all() else np.inf
    lowest = radiosity.min(initial=0)
    if residual > SINGULAR or lowest < -SINGULAR * max(system.emission.max(initial=0), 1e-300):
        raise SolverError(
            "Light has no way to end: the environment is closed, emits and absorbs nothing; lower a reflectance below 1"
        )
    radiosity = np.maximum(radiosity, 0)
    return Solution(
        radiosity=radiosity[:, 0] if system.flat else radiosity,
        method="direct",
        iterations=0,
        residual=residual,
        residuals=np.array([residual]),
        converged=residual <= tolerance,
        warnings=tuple(system.warnings),
    )
