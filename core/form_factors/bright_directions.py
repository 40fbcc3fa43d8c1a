"""Small bright things in a hemisphere, a window in a dark room: found by neighbors, then looked at closely (ccl.4).

A few hundred even directions meet a small window with a handful of rays or none, and the light of a room that it lights
alone is then noise. Neighbors see the same things in nearly the same directions, so together they know where to look.
The hemisphere is a square of cells of equal form factor; cells in which a neighbor has met something bright, and those
around them, are taken out of the even sample and divided, again and again where their four quarters differ by more than
matters.

Which cells are divided is up to the neighbors' rays alone, never the receiver's own: whoever corrected only what it had
seen itself would leave those as they are that saw nothing, and be too dark on the mean. What no neighbor has met either
stays in the even sample, which is right on the mean.

Choose it behind any even sample of directions. Cost: nothing where no single ray matters; some hundred rays more per
receiver near a window. Limits: things below a thousandth of the hemisphere may be known to too few neighbors.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

import numpy as np

from ..frames import tangents
from ..keys import curve_keys, row_keys
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .cached_hemispheres import HitTable, hemisphere_directions, turns_of_names, variants_of
from .concentric import disk_to_square, square_to_disk

#: Cells along a side of the square. A window of a fiftieth of the hemisphere covers five.
GRID = 16

#: Times that a cell is halved at most: the smallest quarter is a 65,536th of the hemisphere.
HALVINGS = 4

#: How much more than matters the brightest thing may give from a quarter that is not divided though its ray missed it.
#: Cells are divided from the start until no quarter is above that.
OVERLOOKED = 16.0

#: Share of the cells from which nothing is small any more, and the even sample serves.
MOST = 0.5

#: How many of those before and after a receiver along a curve through all that have met something bright are asked
#: too, and how far away they may be, in unit lengths.
ALONG, NEARBY = 8, 0.1

#: Receivers handled at a time.
BLOCK = 2048


class BrightDirections:
    """Cells in which each of `count` receivers has met something bright."""

    def __init__(self, count: int):
        self._slots = np.full(count, -1, np.int32)
        self._cells = np.empty((0, GRID * GRID // 8), np.uint8)
        self._points = np.empty((0, 3), np.float32)
        self._normals = np.empty((0, 3), np.float32)

    def note(
        self,
        who: np.ndarray,
        points: np.ndarray,
        normals: np.ndarray,
        bright: np.ndarray,
        names: np.ndarray,
        seed: int,
    ) -> None:
        """Remember for receivers `who` (n,) which rays (n, N) of the even sample `gather` took met something bright.

        `names` and `seed` are those that `gather` was given.
        """
        some = np.flatnonzero(bright.any(axis=1))
        if not len(some):
            return
        row, ray = np.nonzero(bright[some])
        cells = np.zeros((len(some), GRID * GRID), bool)
        cells[row, _cells_of_rays(bright.shape[1], names[some][row], ray, seed)] = True
        self._slots[who[some]] = len(self._cells) + np.arange(len(some), dtype=np.int32)
        self._cells = np.concatenate([self._cells, np.packbits(cells, axis=1)])
        self._points = np.concatenate([self._points, points[some].astype(np.float32)])
        self._normals = np.concatenate([self._normals, normals[some].astype(np.float32)])

    def around(self, who: np.ndarray, points: np.ndarray, normals: np.ndarray, neighbors: np.ndarray) -> np.ndarray:
        """(n, cells) bool: where neighbors (n, k) of receivers `who` (n,), and others that stand near, have met
        something bright, and next to it."""
        marked = np.zeros((len(who), GRID * GRID), bool)
        if not len(self._cells):
            return marked
        slots = np.concatenate([self._slots[neighbors], self._along(points)], axis=1)
        slots[slots == self._slots[who, None]] = -1
        row, column = np.nonzero(slots >= 0)
        slot = slots[row, column]
        pair, cell = np.nonzero(np.unpackbits(self._cells[slot], axis=1))
        if not len(pair):
            return marked
        row, slot = row[pair], slot[pair]
        local = _lifted(square_to_disk((np.stack([cell // GRID, cell % GRID], axis=1) + 0.5) / GRID))
        world = _to_world(local, self._normals[slot])
        one, other = tangents(normals[row])
        height = np.einsum("ij,ij->i", world, normals[row])
        disk = np.stack([np.einsum("ij,ij->i", world, one), np.einsum("ij,ij->i", world, other)], axis=1)
        above = height > 0
        marked[row[above], _cells(disk[above])] = True
        return _dilated(marked)

    def _along(self, points: np.ndarray) -> np.ndarray:
        """(n, 2 * ALONG) slots of those that stand near each point (n, 3), -1 for none."""
        keys = curve_keys(self._points)
        order = np.argsort(keys, kind="stable").astype(np.int32)
        place = np.searchsorted(keys[order], curve_keys(points))
        window = place[:, None] + np.arange(-ALONG, ALONG)
        slots = order[np.clip(window, 0, len(order) - 1)]
        far = ((self._points[slots] - points[:, None]) ** 2).sum(axis=2) > NEARBY**2
        return np.where(far, -1, slots)


def sharpen(
    tracer: Tracer,
    hits_to_rows: HitTable,
    light_of: Callable[[np.ndarray], np.ndarray],
    points: np.ndarray,
    normals: np.ndarray,
    rows: np.ndarray,
    marked: np.ndarray,
    limits: np.ndarray,
    brightest: float,
    names: np.ndarray,
    seed: int,
    pool: RayPool,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Irradiance (n, c) from an even sample outside the marked cells and a divided one inside; and the rays it took.

    Parameters
    ----------
    light_of : callable
        From table rows (m,) to their radiosity (m, c), c being 3 without light groups; only the first three decide.
    points, normals : (n, 3) float32
    rows : (n, N) int32
        Table rows that `gather` found with these `names` (n,) and `seed`.
    marked : (n, cells) bool
        As `BrightDirections.around` gives; each receiver has some, and not all.
    limits : (n,) float
        Irradiance by which the quarters of a cell may differ.
    brightest : float
        Radiosity of the brightest thing met.
    """
    count, rays = rows.shape
    columns = light_of(rows[:0, 0]).shape[1]
    out = np.empty((count, columns), np.float32)
    spent = 0
    block = max(1, 3 * BLOCK // columns)
    for start in range(0, count, block):
        part = slice(start, start + block)
        row, ray = np.divmod(np.arange(rows[part].size), rays)
        outside = ~marked[part][row, _cells_of_rays(rays, names[part][row], ray, seed)]
        radiosity = np.where(outside[:, None], light_of(rows[part].ravel()), 0).reshape(-1, rays, columns)
        kept = np.maximum(outside.reshape(-1, rays).sum(axis=1), 1)
        share = 1 - marked[part].mean(axis=1)
        even = radiosity.sum(axis=1) * (share / kept)[:, None]
        work = _Divided(tracer, hits_to_rows, light_of, points[part], normals[part], names[part], seed, pool)
        found, cast = work.irradiance(marked[part], limits[part], brightest, columns)
        out[part] = even + found
        spent += cast
        yield min(start + block, count) / count
    return out, spent


class _Divided:
    """Sends rays into cells, and into quarters of those that turn out to matter."""

    def __init__(self, tracer, hits_to_rows, light_of, points, normals, names, seed, pool):
        self.tracer, self.hits_to_rows, self.light_of, self.pool = tracer, hits_to_rows, light_of, pool
        self.starts = (points + np.float32(OFFSET) * normals).astype(np.float32)
        self.normals, self.names, self.seed = normals, names, seed

    def irradiance(
        self, marked: np.ndarray, limits: np.ndarray, brightest: float, columns: int
    ) -> tuple[np.ndarray, int]:
        """(n, columns) what comes from the marked cells, and the rays it took."""
        total, spent = np.zeros((len(marked), columns)), 0
        who, cell = np.nonzero(marked)
        corner, width = np.stack([cell // GRID, cell % GRID], axis=1), 1.0 / GRID
        for halving in range(HALVINGS):
            weight = width * width / 4
            is_last = halving == HALVINGS - 1
            # Those that one ray in each quarter would be too few for are not asked, but divided at once.
            coarse = (brightest * weight > OVERLOOKED * limits[who]) & (not is_last)
            asked, places = who[~coarse], _quarters(corner[~coarse])
            found = self.light_of(self._meet(np.repeat(asked, 4), places, width / 2)).reshape(-1, 4, columns)
            spent += len(places)
            differ = np.zeros(len(asked), bool)
            if not is_last:
                # By columns: a reduction along so short an axis takes ten times as long.
                one, two, three, four = np.maximum(np.maximum(found[..., 0], found[..., 1]), found[..., 2]).T
                most = np.maximum(np.maximum(one, two), np.maximum(three, four))
                least = np.minimum(np.minimum(one, two), np.minimum(three, four))
                differ = (most - least) * weight > limits[asked]
                differ |= _touched(asked, corner[~coarse], differ, round(1 / width))
            for channel in range(columns):
                amounts = found[~differ, :, channel] @ np.full(4, weight)
                total[:, channel] += np.bincount(asked[~differ], weights=amounts, minlength=len(marked))
            corner = np.concatenate([_quarters(corner[coarse]), places.reshape(-1, 4, 2)[differ].reshape(-1, 2)])
            who = np.repeat(np.concatenate([who[coarse], asked[differ]]), 4)
            width /= 2
            if not len(who):
                break
        return total, spent

    def _meet(self, owner: np.ndarray, corners: np.ndarray, width: float) -> np.ndarray:
        """Table rows (m,) of one ray in each square of side `width`, numbered by `corners` (m, 2) from the origin."""
        rows = np.empty(len(owner), np.int32)
        steps = round(1 / width)

        def work(start: int, stop: int) -> None:
            who, corner = owner[start:stop], corners[start:stop]
            mixed = row_keys(self.names[who], corner[:, 0] * steps + corner[:, 1], np.full(len(who), self.seed + steps))
            jitter = np.stack([mixed >> np.uint64(44), (mixed >> np.uint64(24)) & np.uint64(0xFFFFF)], axis=1) / 2**20
            local = _lifted(square_to_disk(((corner + jitter) * width).astype(np.float32)))
            directions = _to_world(local, self.normals[who]).astype(np.float32, copy=False)
            luck = None
            if self.tracer.veil is not None:
                luck = ((mixed & np.uint64(0xFFFFF)) / 2**20).astype(np.float32)
            hits = self.tracer.closest(self.starts[who], directions, luck)
            rows[start:stop] = self.hits_to_rows.look_up(hits, directions)

        self.pool.run(work, len(owner), CHUNK_RAYS)
        return rows


def _cells_of_rays(rays: int, names: np.ndarray, which: np.ndarray, seed: int) -> np.ndarray:
    """Cell (m,) of ray number `which` (m,) of the even sample of the receivers with these names (m,)."""
    lattice = hemisphere_directions(rays)[:, :, :2]
    places = lattice[variants_of(names), which]
    turns = turns_of_names(names, seed)
    cos, sin = np.cos(turns), np.sin(turns)
    x, y = places[:, 0], places[:, 1]
    return _cells(np.stack([cos * x - sin * y, sin * x + cos * y], axis=1))


def _cells(disk: np.ndarray) -> np.ndarray:
    column = np.minimum((disk_to_square(disk) * GRID).astype(np.int64), GRID - 1)
    return column[:, 0] * GRID + column[:, 1]


def _lifted(disk: np.ndarray) -> np.ndarray:
    """Unit directions (n, 3) above places (n, 2) in the disk."""
    height = np.sqrt(np.maximum(1 - disk[:, 0] ** 2 - disk[:, 1] ** 2, 0))
    return np.concatenate([disk, height[:, None]], axis=1)


def _to_world(local: np.ndarray, normals: np.ndarray) -> np.ndarray:
    one, other = tangents(normals)
    return local[:, :1] * one + local[:, 1:2] * other + local[:, 2:] * normals


def _quarters(corners: np.ndarray) -> np.ndarray:
    """(4 n, 2) the four squares of half the side within each of n squares, numbered from the origin."""
    return (2 * corners[:, None] + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])).reshape(-1, 2)


def _touched(who: np.ndarray, corners: np.ndarray, marked: np.ndarray, steps: int) -> np.ndarray:
    """(n,) bool: which squares of a grid of `steps` a side, numbered from the origin, touch a marked one of the same
    receiver: an outline that four rays have missed goes on next to where others have met it."""
    pitch = steps + 2
    keys = (who.astype(np.int64) * pitch + corners[:, 0] + 1) * pitch + corners[:, 1] + 1
    around = (np.arange(-1, 2)[:, None] * pitch + np.arange(-1, 2)).ravel()
    return np.isin(keys, np.unique(keys[marked][:, None] + around))


def _dilated(marked: np.ndarray) -> np.ndarray:
    """The marked cells (n, cells) and all that touch them."""
    square = np.pad(marked.reshape(-1, GRID, GRID), ((0, 0), (1, 1), (1, 1)))
    rows = square[:, :-2] | square[:, 1:-1] | square[:, 2:]
    return (rows[:, :, :-2] | rows[:, :, 1:-1] | rows[:, :, 2:]).reshape(marked.shape)
