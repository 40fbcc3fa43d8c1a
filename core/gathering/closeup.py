"""Close looks of receivers at what is small and bright: which of their rays say so, and what to do about it.

Binds `form_factors.bright_directions` to a patch solution, for nodes of the bake and for those receivers that are done
again to see how wrong it is.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ..form_factors.bright_directions import MOST, BrightDirections, sharpen
from ..light_groups import whole
from ..progress import finish
from ..solvers.patch_solution import PatchSolution

#: Light of a receiver, as part of the mean, below which details matter no more than there.
DIM = 0.25

#: Differences within a cell of directions that matter, in those that make it looked at: a few dozen of them add up
#: along the outline of a window.
FINE = 0.2


class Closeup:
    """What `count` receivers have seen that is small and bright.

    `detail` is the part of a receiver's light above which what a single ray brings is worth a close look.
    """

    def __init__(self, solution: PatchSolution, count: int, detail: float):
        self.solution, self.detail = solution, detail
        self._known = BrightDirections(count)
        self._brightest = 0.0
        self._dim = 0.0

    def note(
        self,
        who: np.ndarray,
        points: np.ndarray,
        normals: np.ndarray,
        rows: np.ndarray,
        values: np.ndarray,
        seed: int,
    ) -> None:
        """Remember what receivers `who` (n,) of irradiance `values` (n, c) have seen in the table `rows` (n, N) of an
        even sample taken under their own numbers as names."""
        self._dim = max(self._dim, DIM * float(whole(values).max(axis=1).mean())) if len(who) else self._dim
        brightness = whole(self.solution.looked_up()).max(axis=1)[rows]
        bright = brightness > (self.detail * rows.shape[1] * self._levels(values))[:, None]
        self._brightest = max(self._brightest, float(brightness[bright].max(initial=0)))
        self._known.note(who, points, normals, bright, who, seed)

    def marked(self, who: np.ndarray, points: np.ndarray, normals: np.ndarray, around: np.ndarray) -> np.ndarray:
        """(n, cells) bool: where those around (n, k) receivers `who` (n,) say that something is."""
        return self._known.around(who, points, normals, around)

    def values(
        self,
        points: np.ndarray,
        normals: np.ndarray,
        rows: np.ndarray,
        marked: np.ndarray,
        values: np.ndarray,
        names: np.ndarray,
        seed: int,
    ) -> Generator[float, None, tuple[np.ndarray, int]]:
        """What rays bring of the irradiance (n, c) after a close look, or that of the even sample, `values`, where
        there is nothing to look at; and the rays it took. For the rest see `sharpen`."""
        solution = self.solution
        chosen = np.flatnonzero(marked.any(axis=1) & (marked.mean(axis=1) <= MOST))
        if not len(chosen):
            return values, 0

        def light_of(rows: np.ndarray) -> np.ndarray:
            if solution.meet(rows):
                finish(solution.follow())
            return solution.looked_up()[rows, :-1]

        better, rays = yield from sharpen(
            solution.tracer,
            solution.hits_to_rows,
            light_of,
            points[chosen],
            normals[chosen],
            rows[chosen],
            marked[chosen],
            FINE * self.detail * self._levels(values[chosen]),
            self._brightest,
            names[chosen],
            seed,
            solution.pool,
        )
        values = values.copy()
        values[chosen] = better
        return values, rays

    def _levels(self, values: np.ndarray) -> np.ndarray:
        return np.maximum(whole(values).max(axis=1), self._dim)
