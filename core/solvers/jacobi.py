"""Jacobi: every patch gathers from the radiosities of the sweep before (survey eq. 14, all rows at once).

Each sweep follows the light through one more reflection, so iterates never overshoot when they start from the
emission. One matrix product a sweep, in all channels together; sweeps grow as 1 over 1 minus the mean reflectance.
"""

from __future__ import annotations

import numpy as np

from .system import Callback, Solution, System, iterate


def solve_jacobi(
    system: System,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    start: np.ndarray | None = None,
    callback: Callback | None = None,
) -> Solution:
    """Solve by Jacobi sweeps; see `radiosity.core.solve_radiosity` for the parameters.

    References
    ----------
    .. [1] Cohen, Greenberg, "The Hemi-Cube: A Radiosity Solution for Complex Environments", SIGGRAPH 1985.
    """

    def sweep(radiosity, unshot):
        radiosity = radiosity + unshot
        return radiosity, system.gather(radiosity) - radiosity

    return iterate(system, sweep, "jacobi", tolerance, max_iterations, start, callback)
