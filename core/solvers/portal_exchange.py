"""What cells exchange through transparent portals: ``F_ij = f(F_ik, F_kj)`` (survey section 3, [17]).

The factors to a portal say how much light passes it, not where it goes. That is sampled by *lines*: points spread
evenly over the portals between two cells, a *doorway*, and directions of equal contribution. A line is followed both
ways to the patches i and j that it joins, through further doorways if need be; its share of the doorway's area is an
exchange ``A_i F_ij = A_j F_ji``, the same from both ends. Then all exchanges are balanced: scaled by one number for
each patch and doorway of its cell, so that what a patch sends into its doorways is ``A_i F_ik`` exactly. So reciprocity
holds to rounding, and closure as it does inside the cells, however few the lines.

Lines through several doorways are drawn at the first and the last of them, and count half each. One line's worth of
light is spread as if the doorway were diffuse, so that patches met by no line are joined, too.

Cost: lines as the accuracy asks for, 10 to 100 thousand a doorway, two or four rays each; memory of their distinct
pairs of patches. Limits: needs the ray engine, whatever the method of the factors; a pair that exchanges less than the
accuracy through a doorway is known by few lines, or none.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from ..discretization.local_environments import Partition
from ..form_factors.hemisphere import RowCaster
from ..form_factors.sampling import PatchSampler, frames, hemisphere_directions
from ..form_factors.sobol import sobol_points
from ..visibility.embree import RayEngine
from .cell_factors import CellFactors

#: Lines through a doorway in the first round, and at most.
FIRST_LINES, MOST_LINES = 2**12, 2**20

#: Lines in flight: about 60 MB.
BLOCK_LINES = 2**17

#: Lines that are taken as diffuse, in each doorway.
DIFFUSE_LINES = 1

#: Part of the accuracy that lines are held to. They cost little beside the factors inside cells, and what one of them
#: says of a far room is multiplied by the light of the nearest.
LINE_ACCURACY = 0.25

#: Steps of balancing, and the share of the light through doorways that may be left unbalanced. Factors that are not
#: exact may not allow to balance all.
BALANCE_STEPS, BALANCED = 40, 1e-12

#: Steps of conjugate gradients for each, the part of the gap at which they end, and what is added to the diagonal: ends
#: on one side of a doorway may grow as those on the other shrink, which changes nothing.
GRADIENT_STEPS, GRADIENT_TOLERANCE, REGULARITY = 100, 1e-6, 1e-9

#: Share of a portal's light that counts as escaping: row sums of closed cells are off by rounding.
ESCAPED = 1e-9

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PortalExchange:
    """Exchange areas between *ends*: a patch, or all that is outside, as it sees a doorway from one of its sides.

    Attributes
    ----------
    count : int
        Number of patches; the last end's number may be this, which is the outside.
    patches, sides : (e,) int64
        Of each end. Sides are those of doorways, twice the doorway's number, plus 1 behind it.
    totals : (e,) float64
        What each end exchanges with its doorway, in square meters.
    rows, columns : (k,) int64
        Ends that lines have joined, each pair both ways, in ascending order.
    values : (k,) float64
        Exchange of each pair.
    lines : (k,) float64
        Lines that have told it.
    diffuse : (e,) float64
        Exchange by diffuse lines is ``diffuse[e] * diffuse[f]`` between ends on different sides of a doorway.
    unbalanced : float
        Share of the light through doorways by which ends miss their totals.
    cast : int
        Rays cast.
    """

    count: int
    patches: np.ndarray
    sides: np.ndarray
    totals: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    lines: np.ndarray
    diffuse: np.ndarray
    unbalanced: float
    cast: int

    def times(self, radiosity: np.ndarray) -> np.ndarray:
        """Power (n, c) that arrives at patches from their doorways, for a radiosity (n, c)."""
        power = np.zeros_like(radiosity)
        for channel, seen in enumerate(self._seen(radiosity).T):
            arriving = self._sums(self.values * seen[self.columns]) + self.diffuse * self._opposite(self.diffuse * seen)
            power[:, channel] = np.bincount(self.patches, arriving, self.count + 1)[:-1]
        return power

    def variances(self, radiosity: np.ndarray) -> np.ndarray:
        """Variance (n, c) of `times`, as far as lines are few.

        Totals are given. So what is uncertain is where lines go, and that matters as far as what they meet differs from
        the mean that an end sees.
        """
        variances = np.zeros_like(radiosity)
        for channel, seen in enumerate(self._seen(radiosity).T):
            weight = self._sums(self.values) + self.diffuse * self._opposite(self.diffuse)
            mean = self._sums(self.values * seen[self.columns]) + self.diffuse * self._opposite(self.diffuse * seen)
            mean /= np.where(weight > 0, weight, 1)
            off = seen[self.columns] - mean[self.rows]
            drawn = self._sums((self.values * off) ** 2 / self.lines)
            # Where lines are taken as diffuse, none has told: any of the patches opposite may be what is seen.
            squares = self._opposite(self.diffuse * seen**2) - 2 * mean * self._opposite(self.diffuse * seen)
            share = self._opposite(self.diffuse)
            spread = squares + mean**2 * share
            drawn += self.diffuse**2 * share * np.maximum(spread, 0)
            variances[:, channel] = np.bincount(self.patches, drawn, self.count + 1)[:-1]
        return variances

    def _seen(self, radiosity):
        """Radiosity (e, c) of each end; nothing comes from outside."""
        return np.concatenate((radiosity, np.zeros((1, radiosity.shape[1]))))[self.patches]

    def _sums(self, values):
        return np.bincount(self.rows, values, len(self.patches))

    def _opposite(self, values):
        """Sum (e,) over the ends on the other side of each end's doorway."""
        return np.bincount(self.sides, values, self.sides.max(initial=0) + 2)[self.sides ^ 1]


def exchange_through_portals(
    partition: Partition, cells: list[CellFactors], accuracy: float, seed: int = 0, threads: int = 0
) -> PortalExchange:
    """Sample and balance the light through all doorways.

    Parameters
    ----------
    partition : Partition
        With portals.
    cells : list of CellFactors
    accuracy : float
        That of the factors inside cells. Lines are held to `LINE_ACCURACY` of it, as the standard error of the worst
        factor between patches of different cells. Patches smaller than the mean count as that: they would take most of
        the lines, and carry little light.
    seed, threads : int
        As in `radiosity.core.form_factors`.

    Raises
    ------
    MissingRayEngineError
        If rays cannot be traced on this platform.

    References
    ----------
    .. [1] Xu, Peng, Liang, "Accelerated Radiosity Method for Complex Environments", Eurographics 1989.
    .. [2] Sbert, "An Integral Geometry Based Method for Fast Form-Factor Computation", Computer Graphics Forum 12(3),
       1993: exchange by lines.
    """
    pairs, doorways = np.unique(partition.portal_cells, axis=0, return_inverse=True)
    doorways = doorways.reshape(-1)
    ends, totals = _ends(partition, cells, doorways, 2 * len(pairs))
    lines = _Lines(partition, doorways, len(pairs), threads)
    sampled = [lines.through(doorway, LINE_ACCURACY * accuracy, seed) for doorway in range(len(pairs))]
    count = len(ends)
    keys, values, numbers = [], [], []
    for first, second, met, drawn, area in sampled:
        places = np.searchsorted(ends, first), np.searchsorted(ends, second)
        # An end whose factor to the doorway is 0 takes part in nothing, whatever lines have met.
        known = (np.take(ends, places[0], mode="clip") == first) & (np.take(ends, places[1], mode="clip") == second)
        one, other = (place[known] for place in places)
        keys += [one * count + other, other * count + one]
        values += [area * met[known] / drawn] * 2
        numbers += [met[known]] * 2
    keys, places = np.unique(np.concatenate(keys), return_inverse=True)
    places = places.reshape(-1)
    areas = np.bincount(doorways, partition.portals.areas)
    sides = ends % (2 * len(pairs))
    drawn = np.array([entry[3] for entry in sampled])
    diffuse = totals * np.sqrt(DIFFUSE_LINES / (drawn * areas))[sides // 2]
    raw = PortalExchange(
        count=len(partition.environment),
        patches=ends // (2 * len(pairs)),
        sides=sides,
        totals=totals,
        rows=keys // max(count, 1),
        columns=keys % max(count, 1),
        values=np.bincount(places, np.concatenate(values), len(keys)),
        lines=np.bincount(places, np.concatenate(numbers), len(keys)),
        diffuse=diffuse,
        unbalanced=np.inf,
        cast=lines.cast,
    )
    return _balanced(raw)


def _ends(partition, cells, doorways, side_count):
    """Ends as ascending numbers, ``patch * side_count + side``, and what each exchanges with its doorway."""
    keys, totals = [], []
    outside = len(partition.environment)
    for cell in cells:
        count = len(cell.patches)
        sides = 2 * doorways[cell.sides // 2] + cell.sides % 2
        known, places = np.unique(sides, return_inverse=True)
        exchange = cell.areas[:count, None] * cell.matrix[:count, count:]
        sums = exchange @ (places.reshape(-1)[:, None] == np.arange(len(known)))
        escaped = np.maximum(1 - cell.matrix[count:].sum(axis=1), 0)
        lost = np.bincount(places.reshape(-1), cell.areas[count:] * np.where(escaped > ESCAPED, escaped, 0), len(known))
        keys += [(cell.patches[:, None] * side_count + known).ravel(), outside * side_count + known]
        totals += [sums.ravel(), lost]
    keys, totals = np.concatenate(keys), np.concatenate(totals)
    lit = totals > 0
    keys, places = np.unique(keys[lit], return_inverse=True)
    return keys, np.bincount(places.reshape(-1), totals[lit], len(keys))


class _Lines:
    """Lines through doorways, and what they join."""

    def __init__(self, partition: Partition, doorways: np.ndarray, count: int, threads: int):
        portals = partition.portals
        self.patches = np.append(partition.patches, len(partition.environment))
        self.patch_areas = np.append(partition.environment.areas, np.inf)
        self.mean_area = partition.environment.areas.mean()
        self.side_count, self.cast = 2 * count, 0
        self.end_count = len(self.patch_areas) * self.side_count
        self.caster = RowCaster(partition.pieces, threads)
        self.size = self.caster.engine.frame.size
        first = np.searchsorted(np.sort(doorways), np.arange(count))
        self.normals = portals.normals[np.argsort(doorways, kind="stable")[first]]
        self.frames = frames(self.normals)
        self.areas = np.bincount(doorways, portals.areas)
        # The sampler takes the triangles of a doorway for those of one patch.
        of_triangles = doorways[portals.triangle_patches]
        order = np.argsort(of_triangles, kind="stable")
        self.owners = np.append(of_triangles, -1)
        self.sampler = PatchSampler(
            replace(portals, triangles=portals.triangles[order], triangle_patches=of_triangles[order])
        )
        # With one doorway only, it is the one that every line has crossed.
        self.openings = RayEngine(portals.vertices, portals.triangles, threads) if count > 1 else None

    def through(self, doorway: int, accuracy: float, seed: int):
        """Ends (k,) and (k,) that lines have joined, lines for each pair, lines drawn, and the doorway's area."""
        shift = np.random.default_rng((seed, doorway)).random(4)
        drawn, wanted = 0, FIRST_LINES
        keys, halves = np.zeros(0, np.int64), np.zeros(0)
        while True:
            for begin in range(drawn, wanted, BLOCK_LINES):
                places = sobol_points(min(wanted, begin + BLOCK_LINES), 4)[begin:]
                found, weights = self._joined(doorway, (places + shift) % 1)
                keys, index = np.unique(np.concatenate((keys, found)), return_inverse=True)
                halves = np.bincount(index.reshape(-1), np.concatenate((halves, weights)), len(keys))
            drawn = wanted
            ends = np.divmod(keys, self.end_count)
            smaller = np.minimum(*(self.patch_areas[end // self.side_count] for end in ends))
            smaller = np.maximum(smaller, self.mean_area)
            error = (np.sqrt(halves) * self.areas[doorway] / drawn / smaller).max(initial=0)
            if error <= accuracy:
                break
            if drawn == MOST_LINES:
                logger.warning("Factors through a doorway are known to %.2g only, not to %.2g", error, accuracy)
                break
            growth = np.clip((error / accuracy) ** 2, 2, 64)
            wanted = int(min(2 ** np.ceil(np.log2(drawn * growth)), MOST_LINES))
        return *ends, halves, drawn, self.areas[doorway]

    def _joined(self, doorway, square):
        """Distinct pairs of ends (k,) as numbers, and how many of the lines, given by points (s, 4), join each."""
        points = self.sampler(np.array([doorway]), square[None, :, :2])[0]
        directions = hemisphere_directions(square[:, 2:]) @ self.frames[doorway]
        ends, crossed = zip(*(self._end(doorway, points, sign * directions, sign) for sign in (1, -1)), strict=True)
        # Lines are drawn where they leave a patch's own cell; those through several doorways at both of their ends.
        weights = ((crossed[0] == doorway).astype(float) + (crossed[1] == doorway)) / 2
        used = weights > 0
        keys, index = np.unique((ends[0] * self.end_count + ends[1])[used], return_inverse=True)
        return keys, np.bincount(index.reshape(-1), weights[used], len(keys))

    def _end(self, doorway, points, directions, sign):
        """End (s,) of each ray, and the last doorway that it has crossed."""
        met, distances = self._met(points, directions)
        crossed = np.full(len(points), doorway)
        if self.openings is not None:
            back = points + distances[:, None] * directions
            triangles = self.openings.closest(back, -directions)[0]
            self.cast += len(points)
            # Where rounding leads between portals, the line's own doorway stands.
            crossed = np.where(triangles >= 0, self.owners[triangles], doorway)
        behind = np.einsum("si,si->s", directions, self.normals[crossed]) < 0
        return self.patches[met] * self.side_count + 2 * crossed + behind, crossed

    def _met(self, points, directions):
        """Piece that each ray meets, their number for none, and how far it got."""
        self.cast += len(points)
        triangles, _, _, distances = self.caster.engine.closest(points, directions)
        # Beyond the scene, all that a ray can cross lies behind it.
        distances = np.where(triangles < 0, 4 * self.size, distances.astype(np.float64))
        return self.caster.seen(triangles, directions), distances


def _balanced(raw: PortalExchange) -> PortalExchange:
    """Exchanges scaled by one factor for each end, so that they sum to the ends' totals.

    Factors are exponentials of the lowest place of a convex function, found by Newton's method (Knight, Ruiz, "A Fast
    Algorithm for Matrix Balancing", IMA Journal of Numerical Analysis 33(3), 2013).
    """
    logarithms, total = np.zeros(len(raw.patches)), raw.totals.sum()
    for step in range(BALANCE_STEPS + 1):
        scale = np.exp(logarithms)

        def product(vector, scale=scale):
            scaled = scale * vector
            joined = raw._sums(raw.values * scaled[raw.columns]) + raw.diffuse * raw._opposite(raw.diffuse * scaled)
            return scale * joined

        sums = product(np.ones_like(scale))
        gap = raw.totals - sums
        unbalanced = float(np.abs(gap).sum() / total) if total > 0 else 0.0
        if unbalanced <= BALANCED or step == BALANCE_STEPS:
            break
        logarithms += np.clip(_newton_step(product, sums, gap), -1, 1)
    return replace(
        raw,
        values=raw.values * scale[raw.rows] * scale[raw.columns],
        diffuse=raw.diffuse * scale,
        unbalanced=unbalanced,
    )


def _newton_step(product, sums, gap):
    """Solve ``(diag(sums) + product) step = gap`` by conjugate gradients."""
    diagonal = np.where(sums > 0, sums, 1) * (1 + REGULARITY)
    step, rest = np.zeros_like(gap), gap
    shaped = rest / diagonal
    direction, energy = shaped, rest @ shaped
    target = energy * GRADIENT_TOLERANCE**2
    for _ in range(GRADIENT_STEPS):
        if energy <= target:
            break
        image = diagonal * direction + product(direction)
        length = energy / (direction @ image)
        step = step + length * direction
        rest = rest - length * image
        shaped = rest / diagonal
        energy, before = rest @ shaped, energy
        direction = shaped + energy / before * direction
    return step
