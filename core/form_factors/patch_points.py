"""Points and weights that average a function over patches: lattice rules with random shifts.

Each patch is cut into pieces, one for a convex quadrilateral and triangles else, and each piece is the smooth image of
the unit square. A Fibonacci lattice in the square, shifted at random and folded so that it sees a periodic function,
integrates smooth functions with an error of about 1 / points^2, and those with jumps, as at the edge of a shadow, no
worse than other low-discrepancy points. The scatter of independent shifts shows the error.

References
----------
.. [1] Hickernell, "Obtaining O(N^-2+e) Convergence for Lattice Quadrature Rules", MCQMC 2000.
"""

from __future__ import annotations

import numpy as np

from ..environment import Environment


def fibonacci_lattice(level: int) -> np.ndarray:
    """(N, 2) points of the unit square, N the Fibonacci number 1, 2, 3, 5, ... of a level from 0 on."""
    before, count = 1, 1
    for _ in range(level):
        before, count = count, before + count
    steps = np.arange(count)
    return np.stack((steps / count, steps * before % count / count), axis=1)


def fold(points: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1 and back to 0 as the argument runs through the unit interval: the baker's transformation."""
    return 1 - np.abs(2 * (points % 1) - 1)


class PatchPoints:
    """Pieces of all patches of an environment as images of the unit square."""

    def __init__(self, environment: Environment):
        corners, owners = environment.vertices[environment.triangles], environment.triangle_patches
        count = len(environment)
        sizes = np.array([len(loop) for loop in environment.polygons])
        per_patch = np.bincount(owners, minlength=count)
        quads = np.flatnonzero((sizes == 4) & (per_patch == 2))
        loops = np.array([environment.polygons[row] for row in quads]).reshape(-1, 4, 3)
        convex = _is_convex(loops, environment.normals[quads])
        quads, loops = quads[convex], loops[convex]
        others = ~np.isin(owners, quads)
        # A triangle is a quadrilateral with one side collapsed onto its first corner.
        pieces = np.concatenate((loops, corners[others][:, [0, 0, 1, 2]]))
        owner = np.concatenate((quads, owners[others]))
        order = np.argsort(owner, kind="stable")
        self.pieces, self.owner = pieces[order], owner[order]
        self.first = np.searchsorted(self.owner, np.arange(count + 1))

    def pieces_of(self, patches: np.ndarray) -> np.ndarray:
        """(p,) number of pieces of each patch."""
        return (self.first[1:] - self.first[:-1])[patches]

    def __call__(self, patches: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points on patches, from points of the unit square for each patch.

        Parameters
        ----------
        patches : (p,) int
            Patches that have triangles.
        square : (p, s, 2) float
            The same for all pieces of a patch.

        Returns
        -------
        which : (k,) int64
            Place in `patches` that each point belongs to, ascending.
        points : (k, 3) float64
        weights : (k,) float64
            Sum to 1 for each patch.
        """
        counts = self.pieces_of(patches)
        which = np.repeat(np.arange(len(patches)), counts)
        place = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        a, b, c, d = (self.pieces[self.first[patches[which]] + place, None, i] for i in range(4))
        u, v = square[which, :, :1], square[which, :, 1:]
        bottom, top = a + v * (b - a), d + v * (c - d)
        points = bottom + u * (top - bottom)
        density = np.linalg.norm(np.cross(top - bottom, (1 - u) * (b - a) + u * (c - d)), axis=2)
        totals = np.bincount(which, density.sum(axis=1), len(patches))
        weights = density / totals[which][:, None]
        return np.repeat(which, square.shape[1]), points.reshape(-1, 3), weights.ravel()


def _is_convex(loops: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) bool: whether quadrilaterals (n, 4, 3) turn left at every corner."""
    edges = np.roll(loops, -1, axis=1) - loops
    turns = np.einsum("nki,ni->nk", np.cross(np.roll(edges, 1, axis=1), edges), normals)
    return (turns > 0).all(axis=1)
