"""Two levels: light comes from patches and is received by elements, of which there may be many (survey eq. 12 and 13).

Form factors are computed from elements to patches. Those between patches are their area average,
``F_ij = sum_q F_qj A_q / A_i`` (eq. 12), better than any that a few points of a patch could give; the system of patches
is solved; and each element gathers once, ``B_q = E + rho sum_j B_j F_qj`` (eq. 13), with no system of its own. So q
elements on p patches cost q rows of p factors instead of q rows of q, and a system of p equations instead of q.

Both identities are repaired between patches, and handed down to the elements in proportion. So power is kept, and the
area average of the elements of a patch is the patch's radiosity, whatever the accuracy.

Choose it where shading is to be finer than what lights it needs to be. Limits: an element near another patch sees that
patch with one radiosity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..discretization.hierarchy import Hierarchy, SubdivisionLimits
from ..environment import Environment
from ..errors import SolverError
from ..form_factors.hemisphere import seam_leaks
from ..form_factors.identities import repair
from ..form_factors.matrix import CLOSED_SHARE
from ..form_factors.rows_on_demand import Receivers, RowsOnDemand, rows_on_demand
from ..visibility.embree import OFFSET
from .choice import solve_radiosity
from .system import Callback, Quantities, Solution


@dataclass(frozen=True)
class ElementFactors:
    """Form factors from q elements to p patches.

    Attributes
    ----------
    matrix : (q, p) float64
        Share of the power leaving each element that reaches each patch.
    patches : (q,) int64
        Patch of each element; each patch has one at least.
    areas : (q,) float64
        Radiating areas of the elements.
    """

    matrix: np.ndarray
    patches: np.ndarray
    areas: np.ndarray

    def __post_init__(self):
        count = self.matrix.shape[1] if np.ndim(self.matrix) == 2 else -1
        if count < 0 or np.shape(self.patches) != (len(self.matrix),) or np.shape(self.areas) != (len(self.matrix),):
            raise SolverError("Element factors must be (q, p), with a patch (q,) and an area (q,) for each element")
        if not np.array_equal(np.unique(self.patches), np.arange(count)):
            raise SolverError(f"Each of the {count} patches needs an element, and each element one of them")

    def patch_areas(self) -> np.ndarray:
        """(p,) areas of the patches."""
        return np.bincount(self.patches, self.areas, self.matrix.shape[1])

    def patch_matrix(self) -> np.ndarray:
        """(p, p) form factors between patches: the area average over their elements, survey eq. 12."""
        order = np.argsort(self.patches, kind="stable")
        starts = np.searchsorted(self.patches[order], np.arange(self.matrix.shape[1]))
        sums = np.add.reduceat(self.matrix[order] * self.areas[order, None], starts, axis=0)
        return sums / self.patch_areas()[:, None]

    def repaired(self, closed: bool) -> ElementFactors:
        """Factors whose averages obey reciprocity, and whose rows sum to 1 on average over a patch where `closed`.

        Elements share a change of their patch's factor in proportion to their own.
        """
        before = self.patch_matrix()
        after = repair(before, self.patch_areas(), closed)
        lit = before > 0
        gain, added = np.where(lit, after / np.where(lit, before, 1), 0), np.where(lit, 0, after)
        return replace(self, matrix=self.matrix * gain[self.patches] + added[self.patches])


@dataclass(frozen=True)
class TwoLevelSolution(Solution):
    """The solution of the patches, and what elements gathered from it.

    Attributes
    ----------
    elements : (q, c) float64
        Radiosity of the elements; (q,) when emission and reflectance came without channels.
    factors : ElementFactors
    hierarchy : Hierarchy or None
        Where the elements lie, in the order of its `elements`; None where factors came as an array.
    rows : int
        Rows of form factors computed for it.
    """

    elements: np.ndarray | None = None
    factors: ElementFactors | None = None
    hierarchy: Hierarchy | None = None
    rows: int = 0


def solve_two_level(
    factors: ElementFactors,
    reflectance: float | np.ndarray,
    emission: float | np.ndarray,
    solver: str = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    start: np.ndarray | None = None,
    **options,
) -> TwoLevelSolution:
    """Solve for the patches, then gather at the elements.

    Parameters
    ----------
    factors : ElementFactors
    reflectance, emission : float, (p,) or (p, c)
        Of the patches.
    solver : str
        For the patches; it and all that follows are as in `radiosity.core.solve_radiosity`.

    Returns
    -------
    TwoLevelSolution

    References
    ----------
    .. [1] Cohen, Greenberg, Immel, Brock, "An Efficient Radiosity Approach for Realistic Image Synthesis", IEEE
       Computer Graphics and Applications 6(3), 1986.
    """
    areas = factors.patch_areas()
    patches = solve_radiosity(
        factors.patch_matrix(),
        reflectance,
        emission,
        areas,
        solver,
        tolerance,
        max_iterations,
        callback,
        start,
        **options,
    )
    known = Quantities.of_patches(len(areas), reflectance, emission, areas)
    arriving = factors.matrix @ patches.radiosity.reshape(len(areas), -1)
    elements = known.emission[factors.patches] + known.reflectance[factors.patches] * arriving
    return TwoLevelSolution(
        **vars(patches), elements=elements[:, 0] if known.flat else elements, factors=factors, rows=len(factors.matrix)
    )


def two_level(
    environment: Environment,
    limits: SubdivisionLimits | None = None,
    solver: str = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    callback: Callback | None = None,
    factor_method: str = "auto",
    **choices,
) -> TwoLevelSolution:
    """Divide surfaces into patches and elements, compute the factors between them, and solve.

    Parameters
    ----------
    environment : Environment
        The surfaces.
    limits : SubdivisionLimits, optional
        Sizes of patches and elements.
    solver, tolerance, max_iterations, callback
        Of the system of patches.
    factor_method : str
        ``method`` of the form factors; those that know patches only are refused.
    **choices
        Of the form factors: ``visibility``, ``accuracy``, ``seed``, ``threads`` and options of the method, as in
        `radiosity.core.form_factors`.

    Returns
    -------
    TwoLevelSolution
        Patches in the order of `Hierarchy.patch_nodes`, elements in that of `Hierarchy.elements`.

    Raises
    ------
    SceneTooLargeError
        If the limits ask for more patches than elements are allowed.
    SettingsError
        If a name is unknown or a value out of range.
    """
    hierarchy = Hierarchy.build(environment, limits)
    rows = PatchRows(hierarchy, factor_method, **choices)
    nodes = hierarchy.elements
    solution = rows.solve(hierarchy, rows.of(hierarchy, nodes), solver, tolerance, max_iterations, callback)
    return replace(solution, hierarchy=hierarchy, rows=len(nodes))


class PatchRows:
    """Form factors from any nodes of a hierarchy to its patches.

    Parameters
    ----------
    hierarchy : Hierarchy
        Whose patches are seen; those who look may be nodes of a refined one.
    factor_method, accuracy, **choices
        As in `two_level`.
    """

    def __init__(self, hierarchy: Hierarchy, factor_method: str = "auto", accuracy: float = 1e-3, **choices):
        self.patches = hierarchy.polygons(hierarchy.patch_nodes)
        self.accuracy = accuracy
        self._rows: RowsOnDemand = rows_on_demand(self.patches, factor_method, accuracy=accuracy, **choices)

    def of(self, hierarchy: Hierarchy, nodes: np.ndarray) -> np.ndarray:
        """(r, p) factors from nodes to patches."""
        return self._rows.of(Receivers(hierarchy.polygons(nodes), hierarchy.patches[nodes], nodes))

    def solve(self, hierarchy: Hierarchy, matrix: np.ndarray, *how) -> TwoLevelSolution:
        """Solution from the factors (q, p) of all elements; the scene counts as closed where all rows say so."""
        nodes = hierarchy.elements
        sides = np.where(hierarchy.environment.two_sided[hierarchy.surfaces[nodes]], 2, 1)
        raw = ElementFactors(matrix, hierarchy.patches[nodes], hierarchy.areas[nodes] * sides)
        escaped = 1 - raw.patch_matrix().sum(axis=1)
        closed = bool((escaped <= CLOSED_SHARE * self.accuracy + seam_leaks(self.patches, self._offset())).all())
        return solve_two_level(raw.repaired(closed), self.patches.reflectance, self.patches.emission, *how)

    def _offset(self):
        return OFFSET * float(np.ptp(self.patches.vertices, axis=0).max())
