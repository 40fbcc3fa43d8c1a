"""Radiosity of the patches: one round of rays, then as many bounces as wanted on what they met.

Each patch gathers at four points, direct light by the lights' own way and the rest over the hemisphere. The rows met
are kept, so the system B = rho (D + F B) is solved on numbers alone. Backs are patches of their own, but only those are
worked on that some ray has met: a closed room never pays for its outside.

The inside of a solid is told by its rays: no light reaches it, and all it sees is as enclosed as itself. Its backs are
taken as black, or white walls would multiply what slips through a crack a thousand times. Sample points that see only
such backs are left out of their patch's mean, or the dark under a cupboard would bleed out from beneath it.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..discretization.patches import POINTS, Patches
from ..form_factors.bright_directions import MOST, BrightDirections, sharpen
from ..form_factors.cached_hemispheres import Gathered, HitTable, gather
from ..form_factors.point_rows import PointExchange
from ..lights import Light
from ..lights.direct_light import direct_light
from ..progress import shared_progress
from ..visibility.embree import CHUNK_RAYS, RayPool, Tracer
from .anderson import MEMORY, mixed
from .reciprocity import SeenRows, two_way_factors
from .sparse_rows import SparseRows

#: A point is buried when more than this part of its rays meets dark backs. Inside a solid all of them do; under a
#: sheet, a table's top say, many may, and that shade is real.
BURIED = 0.8

#: A point is enclosed when this part of its rays meets enclosed patches: all but what slips through cracks.
ENCLOSED = 0.95

#: Patches whose sample points lie within this part of the wanted side of a patch are sampled at their middle only: a
#: triangle or cell of a quarter of that side, whose light is one to all that do not stand close.
SMALL = 0.1

#: Rounds of looking which patches stay enclosed when others turn out not to be; a solid settles in two or three.
MAX_ROUNDS = 30

#: Bounces at most in one solution.
MAX_SWEEPS = 200

#: Bounces among backs that only receivers see.
LATE_BOUNCES = 3


@dataclass
class _Side:
    """Patches worked on, by k sample points each: rows of the table, their light, and what they see."""

    rows: np.ndarray
    direct: np.ndarray  # (n, k, 3)
    seen: Gathered  # of n * k points
    kept: np.ndarray  # (n, k) bool: not buried

    @property
    def each(self) -> int:
        """Sample points per patch."""
        return self.kept.shape[1]


@dataclass
class PatchSolution:
    """Radiosity of fronts and backs, growing as rays meet new backs.

    `radiosity` (2P, 3) is what a ray gathers: reflected light, and the emission of what is not sampled as a light.
    `irradiance` (2P, 3) is what arrives. The solver stops when a bounce changes the radiosity by less than `tolerance`,
    RMS by area, relative to the RMS of the radiosity. `detail` is the part of a point's light that a single ray to the
    sky may carry before its neighborhood is looked at closely. `exchange` is what brings the light of patches to
    receivers where that is not left to rays.
    """

    tracer: Tracer
    hits_to_rows: HitTable
    lights: Sequence[Light]
    reflectance: np.ndarray  # (P, 3)
    emission: np.ndarray  # (P, 3), of patches not sampled as lights
    two_sided: np.ndarray  # (P,)
    rays: int
    penumbra_rays: int
    pool: RayPool
    seed: int
    tolerance: float
    detail: float
    radiosity: np.ndarray = field(init=False)
    irradiance: np.ndarray = field(init=False)
    buried: np.ndarray = field(init=False)
    active: np.ndarray = field(init=False)
    _met: np.ndarray = field(init=False)
    _small: np.ndarray = field(init=False)
    enclosed: np.ndarray = field(init=False)
    factors: SparseRows = field(init=False)
    exchange: PointExchange | None = field(init=False, default=None)
    sweeps: int = 0
    residual: float = 0.0
    rays_traced: int = 0
    _sides: list[_Side] = field(default_factory=list)

    def __post_init__(self) -> None:
        count = self.patches.count
        self.irradiance = np.zeros((2 * count, 3), np.float32)
        self.radiosity = self.emitted
        self.active = np.zeros(2 * count, bool)
        self.buried = np.zeros(2 * count, bool)
        self._met = np.zeros(self.hits_to_rows.rows, bool)
        apart = np.linalg.norm(self.patches.points - self.patches.points[:, :1], axis=2).max(axis=1)
        self._small = apart < SMALL * self.patches.spacing
        self.enclosed = np.zeros(2 * count, bool)

    @property
    def patches(self) -> Patches:
        """The patches whose radiosity this is."""
        return self.hits_to_rows.patches

    def table(self) -> np.ndarray:
        """(rows, 4) float32, for `Gathered.irradiance`."""
        return self.hits_to_rows.table(self.radiosity)

    def looked_up(self) -> np.ndarray:
        """(rows, 4) float32: the part of the table that rays bring to receivers; `exchange` brings the rest."""
        return self.table()

    def dark_rows(self) -> np.ndarray:
        """(rows,) bool: backs inside solids, and backs that reflect nothing."""
        dark = np.zeros(self.hits_to_rows.rows, bool)
        count = self.patches.count
        dark[count : 2 * count] = self.enclosed[count:]
        dark[self.hits_to_rows.black_row] = True
        return dark

    def solve(self) -> Generator[float, None, None]:
        """Gather at all fronts and at every back that is met, then solve."""
        count = self.patches.count
        fronts = np.arange(count)[self.patches.areas > 0]
        for done in self._activate(fronts):
            yield 0.7 * done
        while len(new := self._met_backs()):
            for done in self._activate(new):
                yield 0.7 + 0.1 * done
        self._find_enclosed(self._sides)
        self._find_buried(self._sides)
        batches = [SeenRows(side.rows, side.seen.rows, side.kept) for side in self._sides]
        self.factors = two_way_factors(batches, np.tile(self.patches.areas, 2), ~self.enclosed)
        yield from shared_progress(self._iterate(self.tolerance), 0.8, 1.0)

    def follow(self) -> Generator[float, None, None]:
        """Work on backs that rays have met since `solve`.

        No patch sees them, or they would have been met before, so they take light from the solution and from each
        other and give none back: a few bounces among them are all.
        """
        known = len(self._sides)
        while len(new := self._met_backs()):
            yield from self._activate(new)
        late = self._sides[known:]
        self._find_enclosed(late)
        self._find_buried(late)
        for _ in range(LATE_BOUNCES):
            self._bounce(late)

    def _bounce(self, sides: list[_Side]) -> None:
        table = self.table()
        for side in sides:
            self.irradiance[side.rows] = _arriving(side, table)
            self.radiosity[side.rows] = (
                self.emitted[side.rows] + self.reflectances[side.rows] * self.irradiance[side.rows]
            )

    def meet(self, rows: np.ndarray) -> bool:
        """Whether rays that lead to these table rows meet a back not yet worked on; if so, call `follow`."""
        count = self.patches.count
        self._met[rows] = True
        return bool((self._met[count : 2 * count] & ~self.active[count:]).any())

    def _met_backs(self) -> np.ndarray:
        count = self.patches.count
        return count + np.nonzero(self._met[count : 2 * count] & ~self.active[count:])[0]

    def _activate(self, rows: np.ndarray) -> Generator[float, None, None]:
        small = self._small[rows % self.patches.count]
        done = 0
        for part, each in ((rows[~small], POINTS), (rows[small], 1)):
            if len(part):
                share = len(part) * each / (len(rows) * POINTS)
                yield from shared_progress(self._sample(part, each), done, done + share)
                done += share
        self.active[rows] = True

    def _sample(self, rows: np.ndarray, each: int) -> Generator[float, None, None]:
        """Gather at the first `each` sample points of the patches."""
        count = self.patches.count
        patch = rows % count
        points = np.ascontiguousarray(self.patches.points[patch, :each].reshape(-1, 3))
        normals = self.patches.normals[patch, :each] * np.where(rows < count, 1, -1).astype(np.float32)[:, None, None]
        normals = np.ascontiguousarray(normals.reshape(-1, 3))
        ring = _rings(len(rows), each)
        work = direct_light(self.tracer, self.lights, points, normals, ring, self.penumbra_rays, self.pool, self.seed)
        direct, rays = yield from shared_progress(work, 0.0, 0.5)
        seed = self.seed + int(rows[0])
        work = gather(self.tracer, self.hits_to_rows, points, normals, self.rays, self.pool, seed)
        seen = yield from shared_progress(work, 0.5, 0.9)
        self.rays_traced += rays + self.rays * len(points)
        if self.hits_to_rows.sky is not None:
            yield from shared_progress(self._see_sky(points, normals, seen, direct, seed, each), 0.9, 1.0)
        self._sides.append(_Side(rows, direct.reshape(-1, each, 3), seen, np.ones((len(rows), each), bool)))
        self._met[seen.rows] = True

    def _see_sky(self, points, normals, seen: Gathered, direct: np.ndarray, seed: int, each: int):
        """Where a small part of the sky is seen, look closely, and add to the direct light (n, 3) what the even sample
        is wrong by: patches in a room with a window are all that brings its light further in."""
        sky = self.hits_to_rows.table(np.zeros_like(self.radiosity))
        even = seen.irradiance(sky)
        level = even.max(axis=1) + direct.max(axis=1)
        if not level.any():
            return
        level = np.maximum(level, level.mean())
        bright = sky[:, :3].max(axis=1)[seen.rows] > (self.detail * self.rays * level)[:, None]
        names = np.arange(len(points))
        known = BrightDirections(len(points))
        known.note(names, points, normals, bright, names, seed)
        # One look a patch, from its middle: light through a window changes little within it.
        middles = names[::each]
        siblings = middles[:, None] + np.arange(each)
        marked = known.around(middles, points[middles], normals[middles], siblings)
        chosen = np.flatnonzero(marked.any(axis=1) & (marked.mean(axis=1) <= MOST))
        middles = middles[chosen]
        values, rays = yield from sharpen(
            self.tracer,
            self.hits_to_rows,
            lambda rows: sky[rows, :3],
            points[middles],
            normals[middles],
            seen.rows[middles],
            marked[chosen],
            self.detail * level[middles],
            float(sky[:, :3].max()),
            middles,
            seed,
            self.pool,
        )
        patches = direct.reshape(-1, each, 3)
        patches[chosen] += (values - even.reshape(-1, each, 3)[chosen].mean(axis=1))[:, None]
        self.rays_traced += rays

    def _find_enclosed(self, sides: list[_Side]) -> None:
        """Mark the patches of these sides that no light reaches and that see nothing but such patches.

        A patch half inside a solid counts as enclosed if one of its points is, or the inside would seem open there.
        """
        inside = np.zeros(self.hits_to_rows.rows, np.uint8)
        inside[: 2 * self.patches.count] = self.enclosed
        inside[self.hits_to_rows.black_row] = 1
        candidates = []
        for side in sides:
            unlit = ~(side.direct > 0).any(axis=2) & ~(self.emitted[side.rows] > 0).any(axis=1)[:, None]
            candidates.append(np.flatnonzero(unlit))
            inside[side.rows[unlit.any(axis=1)]] = 1
        for _ in range(MAX_ROUNDS):
            is_settled = True
            for number, side in enumerate(sides):
                points = candidates[number]
                stays = _share(inside, side.seen.rows, points) >= ENCLOSED
                candidates[number] = points[stays]
                still = np.zeros(len(side.rows), bool)
                still[points[stays] // side.each] = True
                is_settled &= bool(stays.all())
                inside[side.rows] = still
            if is_settled:
                break
        self.enclosed = inside[: 2 * self.patches.count] > 0

    def _find_buried(self, sides: list[_Side]) -> None:
        dark = self.dark_rows()
        for side in sides:
            share = _share(dark, side.seen.rows, np.arange(len(side.seen.rows))).reshape(-1, side.each)
            kept = share <= BURIED
            gone = ~kept.any(axis=1)
            self.buried[side.rows[gone]] = True
            kept[gone] = True
            side.kept = kept

    def given(self) -> np.ndarray:
        """(2P, 3) irradiance by lamps and sky, which no bounce changes."""
        out = np.zeros_like(self.irradiance)
        sky = self.hits_to_rows.table(out)
        for side in self._sides:
            out[side.rows] = _arriving(side, sky)
        return out

    def _iterate(self, tolerance: float) -> Generator[float, None, None]:
        """Fixed point of B = E + rho (D + F B), by Anderson's acceleration of Jacobi sweeps (Walker and Ni 2011)."""
        rho = self.reflectances
        emitted = self.emitted
        radiosity = self.radiosity
        given = self.given()
        steps: list[np.ndarray] = []
        changes: list[np.ndarray] = []
        for sweep in range(MAX_SWEEPS):
            yield sweep / MAX_SWEEPS
            self.irradiance = given + self.factors.times(radiosity)
            image = emitted + rho * self.irradiance
            change = image - radiosity
            self.sweeps += 1
            self.residual = self._size(change) / max(self._size(image), 1e-30)
            if self.residual <= tolerance:
                radiosity = image
                break
            steps.append(image)
            changes.append(change)
            radiosity = mixed(steps[-MEMORY:], changes[-MEMORY:])
        self.radiosity = np.maximum(radiosity, 0)

    def _size(self, values: np.ndarray) -> float:
        """RMS of (2P, 3) values, weighted by area."""
        areas = self.patches.areas
        squares = (values.astype(np.float64) ** 2).sum(axis=1)
        return float(np.sqrt((areas * (squares[: len(areas)] + squares[len(areas) :])).sum()))

    @property
    def open_areas(self) -> np.ndarray:
        """(2P,) area of fronts and backs worked on, but for what lies inside a solid."""
        areas = np.zeros(2 * self.patches.count)
        for side in self._sides:
            areas[side.rows] = self.patches.areas[side.rows % self.patches.count] * side.kept.mean(axis=1)
        return areas

    @property
    def reflectances(self) -> np.ndarray:
        """(2P, 3) reflectance of fronts and backs; those inside solids are black."""
        back = self.reflectance * (self.two_sided & ~self.enclosed[self.patches.count :])[:, None]
        return np.concatenate([self.reflectance, back]).astype(np.float32)

    @property
    def emitted(self) -> np.ndarray:
        """(2P, 3) emission of fronts and backs that is not sampled as a light."""
        return np.concatenate([self.emission, self.emission * self.two_sided[:, None]]).astype(np.float32)

    def gathered_sides(self) -> Iterator[tuple[np.ndarray, np.ndarray, Gathered, np.ndarray]]:
        """For each batch worked on: its rows (n,), direct light (n, k, 3), what its points see, and which of them
        (n, k) count."""
        for side in self._sides:
            yield side.rows, side.direct, side.seen, side.kept

    @property
    def converged(self) -> bool:
        """Whether the solver met its tolerance."""
        return self.residual <= self.tolerance


def _arriving(side: _Side, table: np.ndarray) -> np.ndarray:
    """(n, 3) irradiance of the patches of one side, means over the points that are not buried."""
    arriving = side.direct + side.seen.irradiance(table).reshape(side.direct.shape)
    weight = side.kept / side.kept.sum(axis=1, keepdims=True, dtype=np.float32)
    return np.einsum("npk,np->nk", arriving, weight)


def _share(marked: np.ndarray, rows: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Part (n,) of the rays that lead to marked rows of the table, for the points `which` (n,) of those whose rays lead
    to `rows` (m, r), in blocks of bounded memory."""
    out = np.empty(len(which), np.float32)
    block = max(1, 4 * CHUNK_RAYS // max(rows.shape[1], 1))
    for start in range(0, len(which), block):
        seen = marked[rows[which[start : start + block]]]
        out[start : start + block] = seen.sum(axis=1, dtype=np.int32) / np.float32(rows.shape[1])
    return out


def _rings(count: int, each: int) -> np.ndarray:
    """Edges between the `each` sample points of each of `count` patches: the middle one to the others."""
    start = np.arange(count, dtype=np.int32)[:, None] * each
    return np.stack([np.repeat(start, each - 1, axis=1), start + np.arange(1, each)], axis=2).reshape(-1, 2)
