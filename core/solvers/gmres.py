"""GMRES: the best combination of all sweeps so far, instead of the last one (Krylov's method).

Each step costs one matrix product, like a Jacobi sweep, and n operations per step remembered; the radiosity is the
combination of the products so far that leaves the smallest residual. Light that goes to and fro between bright walls,
which a sweep only weakens by their reflectance, is a single direction among the products and is gone once seen: bright
rooms hardly cost more than dark ones. Needs no reciprocity of the matrix and no areas.

Why it is what ``auto`` takes for large matrices: measured on a Cornell box of 1,024 patches, 3 channels, to an unshot
share of 1e-6; sweeps, products, or shots over n, and CPU time with gauss_seidel at reflectance 0.5 (14 ms) as 1:

======================  ==========  ==========  ============
reflectance             0.5         0.9         0.999
======================  ==========  ==========  ============
direct                  0, 2.8      0, 2.6      0, 2.5
jacobi                  19, 0.9     122, 6.0    1665, 80
gauss_seidel            11, 1       62, 4.9     833, 56
progressive, batch 64   10, 4.2     63, 24      857, 374
BiCGSTAB                10, 0.5     20, 1.0     28, 1.4
conjugate gradients     9, 0.5      16, 0.8     20, 1.1
gmres                   9, 0.7      16, 1.6     20, 1.9
======================  ==========  ==========  ============

At 0.999 Jacobi, Gauss-Seidel and shooting do not end within 200 sweeps; this does, and so does elimination. Conjugate
gradients on the system scaled by the root of area and reflectance, and BiCGSTAB, are a little cheaper while remembering
costs as much as the product does, but the former ask for exact reciprocity and areas, and the latter's residual jumps.

Limits: remembers up to `restart` arrays of n by channels, then begins anew from what it has.
"""

from __future__ import annotations

import numpy as np

from ..errors import SettingsError
from .system import Callback, Solution, System, iterate

#: Products remembered. Rooms need 10 to 25; memory is this over n of the matrix's, per channel.
RESTART = 40

#: Share of its light that a direction loses per reflection, at least, for being used: what only rounding absorbs has no
#: solution, and is left alone.
SINGULAR = 1e-13


def solve_gmres(
    system: System,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    start: np.ndarray | None = None,
    callback: Callback | None = None,
    restart: int = RESTART,
) -> Solution:
    """Solve by restarted GMRES, all channels in one product; see `radiosity.core.solve_radiosity` for the parameters.

    Parameters
    ----------
    restart : int
        Products after which it begins anew.

    Raises
    ------
    SettingsError
        If `restart` is below 1.

    References
    ----------
    .. [1] Saad, Schultz, "GMRES: A Generalized Minimal Residual Algorithm for Solving Nonsymmetric Linear Systems",
       SIAM Journal on Scientific and Statistical Computing 7(3), 1986.
    """
    if restart != int(restart) or restart < 1:
        raise SettingsError(f"Products remembered by gmres must be 1 or more, not {restart}")
    space: _KrylovSpace | None = None

    def sweep(radiosity, unshot):
        nonlocal space
        if space is None or space.size == restart:
            # What the recurrence has lost to rounding is put right here.
            space = _KrylovSpace(system, radiosity, system.gather(radiosity) - radiosity if space else unshot, restart)
        space.extend()
        return space.best()

    solution = iterate(system, sweep, "gmres", tolerance, max_iterations, start, callback)
    return _without_negatives(system, solution, tolerance)


def _without_negatives(system, solution, tolerance):
    """The solution with what lies below 0 raised to it, which brings every patch nearer to its true radiosity."""
    radiosity = solution.radiosity.reshape(len(system.areas), -1)
    raised = np.maximum(radiosity, 0)
    if not (raised != radiosity).any():
        return solution
    residual = system.residual(system.gather(raised) - raised)
    residuals = np.append(solution.residuals[:-1], residual)
    return Solution(
        radiosity=raised.reshape(solution.radiosity.shape),
        method=solution.method,
        iterations=solution.iterations,
        residual=residual,
        residuals=residuals,
        converged=residual <= tolerance,
        warnings=solution.warnings,
        ended_by=solution.ended_by,
    )


class _KrylovSpace:
    """Products of the unshot light, made orthogonal by Arnoldi's method; one space a channel, worked on together.

    The scalar product is weighted by area, so that the result does not depend on how a wall is divided.
    """

    def __init__(self, system: System, radiosity: np.ndarray, unshot: np.ndarray, most: int):
        self.system, self.radiosity, self.size = system, radiosity, 0
        # Patches without area exchange nothing, yet they have an equation.
        areas = np.where(
            system.areas > 0, system.areas, system.areas[system.areas > 0].mean() if system.areas.any() else 1
        )
        self.root = np.sqrt(areas)[:, None]
        count, channels = unshot.shape
        self.basis = np.empty((most + 1, count, channels))
        self.matrix = np.zeros((channels, most + 1, most))
        self.length = self._normalized(self.root * unshot, 0)

    def _normalized(self, vectors, row):
        """Put vectors (n, c), at unit length, into a row of the basis; their lengths (c,). Zeros stay zero."""
        lengths = np.sqrt((vectors * vectors).sum(axis=0))
        self.basis[row] = vectors / np.where(lengths > 0, lengths, 1)
        return lengths

    def extend(self) -> None:
        """Multiply the newest vector by the system, and add what is new of it to the basis."""
        last = self.basis[self.size]
        known = self.basis[: self.size + 1]
        product = last - self.root * self.system.reflectance * (self.system.form_factors @ (last / self.root))
        # Twice is enough for orthogonality to rounding.
        for _ in range(2):
            shares = np.einsum("knc,nc->kc", known, product)
            product -= np.einsum("knc,kc->nc", known, shares)
            self.matrix[:, : self.size + 1, self.size] += shares.T
        before = np.sqrt((last * last).sum(axis=0))
        lengths = self._normalized(product, self.size + 1)
        # What is left of a vector by rounding alone is no direction: the space is complete.
        complete = lengths <= 64 * np.finfo(np.float64).eps * before
        self.basis[self.size + 1][:, complete] = 0
        self.matrix[:, self.size + 1, self.size] = np.where(complete, 0, lengths)
        self.size += 1

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """Radiosity (n, c) of smallest residual in the space, and what it leaves unshot."""
        matrix = self.matrix[:, : self.size + 1, : self.size]
        target = np.zeros((len(matrix), self.size + 1))
        target[:, 0] = self.length
        left, values, right = np.linalg.svd(matrix, full_matrices=False)
        inverses = np.where(values > SINGULAR, 1 / np.where(values > SINGULAR, values, 1), 0)
        weights = np.einsum("cik,ci,cji,cj->ck", right, inverses, left, target, optimize=True)
        left = target - np.einsum("cjk,ck->cj", matrix, weights)
        radiosity = self.radiosity + np.einsum("knc,ck->nc", self.basis[: self.size], weights) / self.root
        return radiosity, np.einsum("knc,ck->nc", self.basis[: self.size + 1], left) / self.root
