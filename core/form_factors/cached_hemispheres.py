"""Gathering light over the hemisphere: which patch each of N equal-contribution directions meets (survey, figure 6).

Nusselt's analog makes every direction of a cosine-weighted set carry the same share 1/N of the form factor. The patches
met are kept as numbers, so that any later radiosity costs a look-up and a mean, and no ray.

Directions are a Fibonacci lattice on the disk, lifted to the hemisphere; 64 of them err as little as about 600 random
ones (study, section 1). Each receiver turns the lattice by its own angle, or neighbors would share their error.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from ..discretization.patches import Patches
from ..frames import turned_frames
from ..scene import Sky
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer

#: Variants of the lattice, so that receivers with nearly the same turn still differ.
VARIANTS = 16

#: Cosine up to which a hit from behind counts as one on the front: a ray along a wall is on either side by rounding.
GRAZING = 1e-4

_GOLDEN = 0.6180339887498949
_SILVER = 0.4142135623730950


def hemisphere_directions(count: int, variants: int = VARIANTS) -> np.ndarray:
    """Cosine-distributed directions (variants, count, 3) float32 around +Z; each carries 1/count of the form factor."""
    shift = ((np.arange(variants) + 0.5) / variants)[:, None]
    turn = (np.arange(variants) * _GOLDEN)[:, None] % 1.0
    index = np.arange(count)[None]
    radius = np.sqrt((index + shift) / count)
    angle = 2 * np.pi * ((index * _GOLDEN + turn) % 1.0)
    height = np.sqrt(np.maximum(1 - radius**2, 0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=2).astype(np.float32)


def variants_of(names: np.ndarray) -> np.ndarray:
    """Variant (n,) of the lattice that receivers with these names (n,) take."""
    return names % VARIANTS


def turns_of(count: int, seed: int) -> np.ndarray:
    """`turns_of_names` of the numbers below `count`."""
    return turns_of_names(np.arange(count), seed)


def turns_of_names(names: np.ndarray, seed: int) -> np.ndarray:
    """Angles (n,) float32 for `turned_frames`, a well-mixed function of names (n,) and seed."""
    # Python integers, cut to 64 bits: NumPy warns when a scalar product wraps.
    index = names.astype(np.uint64) + np.uint64(seed * 0x632BE59BD9B4E019 % 2**64)
    index = (index ^ (index >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
    index = (index ^ (index >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return ((index >> np.uint64(40)).astype(np.float32) * np.float32(2 * np.pi / 2**24)).astype(np.float32)


#: Rays whose radiosities are averaged at once. OpenBLAS shares a product of more than 2^18 multiplications out among
#: threads, and each ray takes 12; this many also stay in the cache.
PRODUCT_RAYS = 16384

#: What of a hit a look-up needs.
_USED = ("primID", "u", "v", "Ng", "tfar")

#: How far the look-up is moved from a patch on which a wall stands, in sides of the patch.
ASIDE = 2.5


@dataclass(frozen=True)
class WallSides:
    """Look-ups on the right side of walls.

    However small the patches, some lie under a wall and have light of both its sides. A ray that ends on one of them is
    looked up a little back along its way, where it has come from its own side; if it starts nearer than that, on the
    wall itself, then a little further on.

    Parameters
    ----------
    crossed : (P,) bool
        Patches on which something stands.
    gradients : (m, 2, 3) float32
        How the weights of each triangle's second and third corner grow along the axes.
    sizes : (P,) float32
        Sides of the patches.
    """

    crossed: np.ndarray
    gradients: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, crossed: np.ndarray, corners: np.ndarray, areas: np.ndarray) -> WallSides:
        """For patches of `areas` (P,) on triangles with `corners` (m, 3, 3)."""
        one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normals = np.cross(one, other)
        normals /= np.maximum(np.einsum("ij,ij->i", normals, normals), 1e-300)[:, None]
        gradients = np.stack([np.cross(other, normals), np.cross(normals, one)], axis=1)
        return cls(crossed, gradients.astype(np.float32), np.sqrt(areas).astype(np.float32))

    def mend(self, rows: np.ndarray, patches: Patches, hits: dict, directions: np.ndarray) -> None:
        """Replace rows (n,) of crossed patches by those of the place aside, in the same triangle."""
        which = np.nonzero(self.crossed[rows])[0]
        if not len(which):
            return
        triangles = hits["primID"][which]
        normals = hits["Ng"][which]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-20))
        along = directions[which]
        along = along - np.einsum("ij,ij->i", along, normals)[:, None] * normals
        length = np.linalg.norm(along, axis=1)
        aside = np.float32(ASIDE) * self.sizes[rows[which]]
        step = np.where(hits["tfar"][which] * length > aside, -aside, aside) / np.maximum(length, np.float32(1e-6))
        move = np.einsum("nki,ni->nk", self.gradients[triangles], along * step[:, None])
        # In a corner of the room the way leads out of the triangle: as far as its border.
        u = np.clip(hits["u"][which] + move[:, 0], 0, 1)
        v = np.clip(hits["v"][which] + move[:, 1], 0, 1 - u)
        rows[which] = patches.at(triangles, u, v)


@dataclass(frozen=True)
class HitTable:
    """How a hit becomes a row of the radiosity table: fronts, backs, sky cells, and two rows that are always black: one
    for backs that reflect nothing, and last one for rays that leave a scene without sky.

    `black_back` (m,) marks triangles whose back reflects nothing. `sides`, where given, tells the two sides of patches
    apart on which a wall stands. `sky_columns` are the first columns, of three each, in which the sky counts: those of
    the whole and of its light group.
    """

    patches: Patches
    black_back: np.ndarray
    sky: Sky | None
    sides: WallSides | None = None
    sky_columns: tuple[int, ...] = (0,)

    @property
    def sky_start(self) -> int:
        """First row of the sky."""
        return 2 * self.patches.count

    @property
    def sky_cells(self) -> int:
        """Number of rows of the sky."""
        return 0 if self.sky is None else self.sky.radiance.shape[0] * self.sky.radiance.shape[1]

    @property
    def rows(self) -> int:
        """Rows of the table, the two black ones included."""
        return self.sky_start + self.sky_cells + 2

    @property
    def black_row(self) -> int:
        """Row of backs that reflect nothing."""
        return self.rows - 2

    @property
    def outside_row(self) -> int:
        """Row of rays that leave a scene without sky."""
        return self.rows - 1

    def table(self, radiosity: np.ndarray) -> np.ndarray:
        """(rows, c + 1) float32 table from the radiosity (2P, c) of fronts and backs, c being 3 without light groups;
        4 wide, because that is fetched fastest."""
        columns = radiosity.shape[1]
        out = np.zeros((self.rows, columns + 1), np.float32)
        out[: self.sky_start, :columns] = radiosity
        if self.sky is not None:
            # Radiance L over the whole hemisphere gives irradiance pi L, as a patch of radiosity pi L would.
            light = np.pi * self.sky.radiance.reshape(-1, 3)
            for first in self.sky_columns:
                out[self.sky_start : self.sky_start + self.sky_cells, first : first + 3] = light
        return out

    def is_outside(self) -> np.ndarray:
        """(rows,) bool: the sky, and what rays lead to that leave a scene without one."""
        outside = np.zeros(self.rows, bool)
        outside[self.sky_start : self.sky_start + self.sky_cells] = True
        outside[self.outside_row] = True
        return outside

    def is_back(self) -> np.ndarray:
        """(rows,) bool: backs of patches, and backs that reflect nothing."""
        back = np.zeros(self.rows, bool)
        back[self.patches.count : self.sky_start] = True
        back[self.black_row] = True
        return back

    def look_up(self, hits: dict, directions: np.ndarray) -> np.ndarray:
        """Row (n,) int32 that each ray leads to."""
        triangles = hits["primID"]
        met = triangles >= 0
        if met.all():
            return self._patch_rows(hits, directions)
        rows = np.full(len(triangles), self.outside_row, np.int32)
        rows[met] = self._patch_rows({name: hits[name][met] for name in _USED}, directions[met])
        if self.sky is not None:
            rows[~met] = self.sky_start + self.sky.cells(directions[~met])
        return rows

    def _patch_rows(self, hits: dict, directions: np.ndarray) -> np.ndarray:
        triangles, facing = hits["primID"], hits["Ng"]
        rows = self.patches.at(triangles, hits["u"], hits["v"])
        if self.sides is not None:
            self.sides.mend(rows, self.patches, hits, directions)
        along = np.einsum("ij,ij->i", facing, directions)
        back = np.nonzero(along > 0)[0]
        if len(back):
            back = back[along[back] > GRAZING * np.linalg.norm(facing[back], axis=1)]
            rows[back] += self.patches.count
            rows[back[self.black_back[triangles[back]]]] = self.black_row
        return rows


@dataclass(frozen=True)
class Gathered:
    """What n receivers see: `rows` (n, N) int32 of the table, and `distances` (n,) float32, the harmonic mean of the
    distances to what was met, large where nothing is near."""

    rows: np.ndarray
    distances: np.ndarray

    def irradiance(self, table: np.ndarray) -> np.ndarray:
        """(n, c) float32 mean of the table (rows, c + 1) over the directions, in blocks of bounded memory."""
        count, rays = self.rows.shape
        if table.shape[1] > 4:
            firsts = range(0, table.shape[1] - 1, 3)
            return np.concatenate([self.irradiance(_four_wide(table[:, at : at + 3])) for at in firsts], axis=1)
        out = np.empty((count, 3), np.float32)
        # The mean as a matrix product: several times faster than a reduction over the middle axis. Blocks are so small
        # that the product is no work for threads of its own: on a busy machine those wait for each other.
        block = max(1, PRODUCT_RAYS // max(rays, 1))
        mean = np.tile(np.eye(4, 3, dtype=np.float32) / np.float32(rays), (rays, 1))
        for start in range(0, count, block):
            seen = table.take(self.rows[start : start + block], axis=0)
            out[start : start + block] = seen.reshape(len(seen), 4 * rays) @ mean
        return out


def _four_wide(colors: np.ndarray) -> np.ndarray:
    """Columns (rows, 3) of a table as a table of their own (rows, 4)."""
    return np.pad(colors, ((0, 0), (0, 1)))


def chosen_directions(normals: np.ndarray, rays: int, seed: int, names: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Directions (n, k, 3) float32 of the `chosen` (n, k) rays among the `rays` that `gather` sends for the same seed
    and names (n,) from points with these normals (n, 3)."""
    turns = turns_of_names(names, seed)
    local = hemisphere_directions(rays)[variants_of(names)[:, None], chosen]
    return np.matmul(local, turned_frames(normals, turns)).astype(np.float32)


def gather(
    tracer: Tracer,
    hits_to_rows: HitTable,
    points: np.ndarray,
    normals: np.ndarray,
    rays: int,
    pool: RayPool,
    seed: int = 0,
    names: np.ndarray | None = None,
) -> Generator[float, None, Gathered]:
    """Trace the hemispheres of n oriented points; yields the share done and returns `Gathered`.

    Parameters
    ----------
    points, normals : (n, 3) float32
        In the unit frame, on the surface: rays start `OFFSET` above.
    rays : int
        Directions per receiver.
    seed : int
        Turns the lattices.
    names : (n,) int or None
        Numbers that decide a receiver's turn, where that must not depend on its place in this call.
    """
    count = len(points)
    rows = np.empty((count, rays), np.int32)
    distances = np.empty(count, np.float32)
    lattice = hemisphere_directions(rays)
    names = np.arange(count) if names is None else np.asarray(names)
    turns = turns_of_names(names, seed)
    variant = variants_of(names)
    starts = (points + np.float32(OFFSET) * normals).astype(np.float32)
    translucent = tracer.veil is not None

    def work(start: int, stop: int) -> None:
        frames = turned_frames(normals[start:stop], turns[start:stop]).astype(np.float32, copy=False)
        directions = np.matmul(lattice[variant[start:stop]], frames).reshape(-1, 3)
        origins = np.repeat(starts[start:stop], rays, axis=0)
        luck = None
        if translucent:
            # One number per direction, spread evenly over each receiver's own set, and over every part of it: the
            # golden ratio would tie it to the azimuth, and a veil would be open on one side and shut on the other.
            luck = ((np.arange(rays) * _SILVER)[None] + turns[start:stop, None] / (2 * np.pi)) % 1.0
            luck = luck.astype(np.float32).ravel()
        hits = tracer.closest(origins, directions, luck)
        rows[start:stop] = hits_to_rows.look_up(hits, directions).reshape(-1, rays)
        near = np.where(hits["primID"] >= 0, 1 / np.maximum(hits["tfar"], np.float32(OFFSET)), np.float32(0))
        distances[start:stop] = rays / np.maximum(near.reshape(-1, rays).sum(axis=1), np.float32(1e-6))

    yield from pool.chunks(work, count, max(1, CHUNK_RAYS // rays))
    return Gathered(rows, distances)
