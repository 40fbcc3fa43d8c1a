"""Adaptive subdivision: elements are halved where the radiosity of neighbors differs by more than the error asked for.

The solution of the patches says what each element receives, whatever its size (`two_level`). So a halved element costs
two rows of factors to the patches and nothing else: rows of all other elements are reused, and the factors between
patches change only by the better average over the halved element's patch. Elements are kept balanced, so that shading
can be interpolated without gaps.

Choose it where light has shadows or falls off steeply in some places and hardly changes in most. The neighbors'
difference estimates the error of a radiosity that is constant over each element; interpolated shading errs less.

Cost: rows of form factors, as many as there are elements in the end, plus one for each element halved on the way: less
than twice. Limits: a shadow that falls between the first elements is not seen, so `element_max` must not be larger than
what matters; differences below the noise of sampled rows are halved in vain, so `accuracy` must be finer than `error`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..discretization.hierarchy import Hierarchy, SubdivisionLimits
from ..environment import Environment
from ..errors import SettingsError
from .system import Callback
from .two_level import PatchRows, TwoLevelSolution


def solve_adaptively(
    environment: Environment,
    error: float,
    limits: SubdivisionLimits | None = None,
    solver: str = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    factor_method: str = "auto",
    **choices,
) -> TwoLevelSolution:
    """Two-level solution whose elements are halved where light changes.

    Parameters
    ----------
    environment : Environment
        The surfaces.
    error : float
        Largest difference between neighbors, relative to the mean radiosity that the scene reflects, in the worst
        channel.
    limits : SubdivisionLimits, optional
        `element_max` is the size to begin with, `element_min` and `max_elements` end the division.
    solver, tolerance, max_iterations, callback, factor_method, **choices
        As in `two_level`.

    Returns
    -------
    TwoLevelSolution

    Raises
    ------
    SettingsError
        If `error` is not above 0.

    References
    ----------
    .. [1] Cohen, Greenberg, Immel, Brock, "An Efficient Radiosity Approach for Realistic Image Synthesis", IEEE
       Computer Graphics and Applications 6(3), 1986.
    """
    if not error > 0:
        raise SettingsError(f"Error between neighbors must be above 0, not {error}")
    hierarchy = Hierarchy.build(environment, limits)
    rows = PatchRows(hierarchy, factor_method, **choices)
    # A row for each node, in the order of nodes; those above the first elements have none.
    known = np.zeros((len(hierarchy.corners), len(hierarchy.patch_nodes)))
    fresh, computed = hierarchy.elements, 0
    while True:
        known[fresh] = rows.of(hierarchy, fresh)
        computed += len(fresh)
        solution = rows.solve(hierarchy, known[hierarchy.elements], solver, tolerance, max_iterations, callback)
        refined = hierarchy.refined(uneven_elements(hierarchy, solution, rows.patches, error))
        count = len(hierarchy.corners)
        if len(refined.corners) == count:
            return replace(solution, hierarchy=hierarchy, rows=computed)
        hierarchy, fresh = refined, np.arange(count, len(refined.corners))
        fresh = fresh[refined.children[fresh, 0] < 0]
        known = np.concatenate((known, np.zeros((len(refined.corners) - count, known.shape[1]))))


def uneven_elements(hierarchy: Hierarchy, solution: TwoLevelSolution, patches: Environment, error: float) -> np.ndarray:
    """Elements to be halved, those first whose neighbors differ most.

    Of two neighbors the larger is halved, or both where they are alike in size. What they emit and how they reflect is
    the same all over a surface: only the light that arrives is compared.
    """
    nodes, factors = hierarchy.elements, solution.factors
    pairs = hierarchy.neighbors()
    arriving = factors.matrix @ solution.radiosity
    reflectance = patches.reflectance[factors.patches]
    scale = factors.areas @ (reflectance * arriving) / factors.areas.sum()
    change = np.abs(arriving[pairs[:, 0]] - arriving[pairs[:, 1]])
    change *= (reflectance[pairs[:, 0]] + reflectance[pairs[:, 1]]) / 2
    change = (change / np.where(scale > 0, scale, np.inf)).max(axis=1, initial=0)
    steep = change > error
    pairs, change = pairs[steep], change[steep]
    areas = hierarchy.areas[nodes]
    worst = np.zeros(len(nodes))
    for one, other in ((0, 1), (1, 0)):
        # Halves of equal size differ by rounding.
        larger = areas[pairs[:, one]] > 0.9 * areas[pairs[:, other]]
        np.maximum.at(worst, pairs[larger, one], change[larger])
    chosen = np.flatnonzero(worst)
    return nodes[chosen[np.argsort(-worst[chosen], kind="stable")]]
