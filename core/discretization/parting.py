"""Parting of triangles and quadrilaterals whose sides are cut into given numbers of segments.

A piece is a triangle or quadrilateral inside an old face; the vertices on its sides exist already. One whose opposite
sides (or all three) have equal numbers is filled by a grid. Any other is parted into smaller ones, by lines between
vertices on its sides, and those are looked at again; lines between parts are cut by length. Every step treats all
pieces at once, and numbers halve with each, so there are about log2 of the largest number of steps.

A batch of pieces is a tuple of arrays (numbers, vertices, weights, bases, steps, counts): the number of the piece (n,),
its corner vertices (n, k), their weights in the four corners of the piece (n, k, 4), and of each side, from one corner
to the next, the segments `counts` and the vertices between, ``bases + steps * i`` for i in 1 .. counts - 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

Batch = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]

# A line between parts takes its neighbor's number of segments, to make a grid, when that is at most this much finer
# than its length needs.
LARGEST_REFINEMENT = 1.35


class Parts:
    """What has been made so far: vertices inside of pieces, and faces.

    Parameters
    ----------
    places : (p, 4, 3) float
        Corners of each piece, to measure lengths; triangles repeat one.
    first_free : int
        Number of the first new vertex.
    needed : function
        Segments that a line from (n, 3) to (n, 3) needs.
    counting : bool
        Count only.
    """

    def __init__(
        self,
        places: np.ndarray,
        first_free: int,
        needed: Callable[[np.ndarray, np.ndarray], np.ndarray],
        counting: bool,
    ) -> None:
        self.vertex_count = first_free
        self.face_count = 0
        self._places = places
        self._needed = needed
        self._counting = counting
        self._inner: list[tuple[np.ndarray, np.ndarray]] = []
        self._faces: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def inner_vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Piece (n,) and weights (n, 4) of the new vertices, in order."""
        if not self._inner:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 4))
        return tuple(np.concatenate(column) for column in zip(*self._inner, strict=True))

    def faces(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Batches of faces: piece (n,), vertices (n, k), weights (n, k, 4)."""
        return iter(self._faces)

    def needed(self, numbers, start, stop):
        """Segments that the lines between two points of each piece, given by weights (n, 4), need."""
        places = self._places[numbers]
        return self._needed(np.einsum('nk,nki->ni', start, places), np.einsum('nk,nki->ni', stop, places))

    def connect(self, numbers, start, stop, counts):
        """New lines with `counts` segments between points given by weights: the base of their vertices."""
        inner = counts - 1
        bases = self.vertex_count - 1 + np.cumsum(inner) - inner
        self.vertex_count += int(inner.sum())
        if not self._counting:
            lines = np.repeat(np.arange(len(counts)), inner)
            share = ((1 + np.arange(len(lines)) - (np.cumsum(inner) - inner)[lines]) / counts[lines])[:, None]
            self._inner.append((numbers[lines], start[lines] * (1.0 - share) + stop[lines] * share))
        return bases

    def fill_quads(self, batch: Batch) -> None:
        """Grids for quadrilaterals with equal numbers on opposite sides."""
        numbers, corners, weights, bases, steps, counts = batch
        across, up = counts[:, 0], counts[:, 1]
        inner = (across - 1) * (up - 1)
        first = self.vertex_count + np.cumsum(inner) - inner
        self.vertex_count += int(inner.sum())
        self.face_count += int((across * up).sum())
        if self._counting or len(numbers) == 0:
            return
        points = (across + 1) * (up + 1)
        start = np.cumsum(points) - points
        item = np.repeat(np.arange(len(numbers)), points)
        local = np.arange(len(item)) - start[item]
        a, b = across[item], up[item]
        i, j = local % (a + 1), local // (a + 1)
        left, right, bottom, top = i == 0, i == a, j == 0, j == b
        inside = ~(left | right | bottom | top)
        vertices = np.where(inside, first[item] + (j - 1) * (a - 1) + i - 1, 0)
        for side, (on, place) in enumerate(((bottom, i), (right, j), (top, a - i), (left, b - j))):
            rows = item[on]
            vertices[on] = bases[rows, side] + steps[rows, side] * place[on]
        for corner, on in enumerate((left & bottom, right & bottom, right & top, left & top)):
            vertices[on] = corners[item[on], corner]
        s, t = (i / a)[:, None], (j / b)[:, None]
        shares = (1.0 - t) * ((1.0 - s) * weights[item, 0] + s * weights[item, 1])
        shares += t * (s * weights[item, 2] + (1.0 - s) * weights[item, 3])
        self._inner.append((numbers[item[inside]], shares[inside]))
        cells = across * up
        item = np.repeat(np.arange(len(numbers)), cells)
        local = np.arange(len(item)) - (np.cumsum(cells) - cells)[item]
        width = across[item] + 1
        corner = start[item] + local // across[item] * width + local % across[item]
        rows = np.stack([corner, corner + 1, corner + 1 + width, corner + width], axis=1)
        self._faces.append((numbers[item], vertices[rows], shares[rows]))

    def fill_triangles(self, batch: Batch) -> None:
        """Grids for triangles with equal numbers on all sides: rows parallel to the side opposite the first corner."""
        numbers, corners, weights, bases, steps, counts = batch
        count = counts[:, 0]
        inner = (count - 1) * (count - 2) // 2
        first = self.vertex_count + np.cumsum(inner) - inner
        self.vertex_count += int(inner.sum())
        self.face_count += int((count * count).sum())
        if self._counting or len(numbers) == 0:
            return
        points = (count + 1) * (count + 2) // 2
        start = np.cumsum(points) - points
        item = np.repeat(np.arange(len(numbers)), points)
        local = np.arange(len(item)) - start[item]
        row = ((np.sqrt(8.0 * local + 1.0) - 1.0) * 0.5).astype(np.int64)
        place = local - row * (row + 1) // 2
        n = count[item]
        sides = (place == 0, row == n, place == row)
        inside = ~(sides[0] | sides[1] | sides[2])
        vertices = np.where(inside, first[item] + (row - 2) * (row - 1) // 2 + place - 1, 0)
        for side, along in enumerate((row, place, n - row)):
            on = sides[side]
            rows = item[on]
            vertices[on] = bases[rows, side] + steps[rows, side] * along[on]
        for corner, on in enumerate((row == 0, sides[1] & sides[0], sides[1] & sides[2])):
            vertices[on] = corners[item[on], corner]
        shares = ((n - row) / n)[:, None] * weights[item, 0]
        shares += ((row - place) / n)[:, None] * weights[item, 1] + (place / n)[:, None] * weights[item, 2]
        self._inner.append((numbers[item[inside]], shares[inside]))
        cells = count * count
        item = np.repeat(np.arange(len(numbers)), cells)
        local = np.arange(len(item)) - (np.cumsum(cells) - cells)[item]
        row = np.sqrt(local.astype(np.float64)).astype(np.int64)
        place = (local - row * row) // 2
        down = (local - row * row) % 2 == 1
        upper = start[item] + row * (row + 1) // 2 + place
        lower = start[item] + (row + 1) * (row + 2) // 2 + place
        rows = np.stack([upper, np.where(down, lower + 1, lower), np.where(down, upper + 1, lower + 1)], axis=1)
        self._faces.append((numbers[item], vertices[rows], shares[rows]))


def _take(batch: Batch, rows) -> Batch:
    return tuple(column[rows] for column in batch)


def _join(batches: list[Batch], width: int) -> Batch:
    if not batches:
        empty = np.zeros((0, width), dtype=np.int64)
        return empty[:, 0], empty, np.zeros((0, width, 4)), empty, empty, empty
    return tuple(np.concatenate(column) for column in zip(*batches, strict=True))


def _turned(batch: Batch, first) -> Batch:
    """The same pieces, their corners counted from corner `first`."""
    numbers, *columns = batch
    width = columns[0].shape[1]
    order = (first[:, None] + np.arange(width)) % width
    rows = np.arange(len(numbers))[:, None]
    return (numbers, *(column[rows, order] for column in columns))


class _Sides:
    """The sides of a batch, to be cut and recombined."""

    def __init__(self, parts: Parts, batch: Batch) -> None:
        self.parts = parts
        self.numbers, self.vertices, self.weights, self.bases, self.steps, self.counts = batch

    def corner(self, place):
        return self.vertices[:, place], self.weights[:, place]

    def cut(self, side, at):
        """A corner on a side, `at` segments from its start; the side before it, and after."""
        base, step, count = self.bases[:, side], self.steps[:, side], self.counts[:, side]
        share = (at / count)[:, None]
        weights = self.weights[:, side] * (1.0 - share) + self.weights[:, (side + 1) % self.counts.shape[1]] * share
        middle = base + step * at
        return (middle, weights), (base, step, at), (middle, step, count - at)

    def side(self, side):
        return self.bases[:, side], self.steps[:, side], self.counts[:, side]

    def needed(self, start, stop):
        return self.parts.needed(self.numbers, start[1], stop[1])

    def line(self, start, stop, counts):
        """A new line, there and back."""
        bases = self.parts.connect(self.numbers, start[1], stop[1], counts)
        ones = np.ones_like(counts)
        return (bases, ones, counts), (bases + counts, -ones, counts)

    def piece(self, corners, sides) -> Batch:
        vertices = np.stack([corner[0] for corner in corners], axis=1)
        weights = np.stack([corner[1] for corner in corners], axis=1)
        return (self.numbers, vertices, weights, *(np.stack(column, axis=1) for column in zip(*sides, strict=True)))


def _snapped(needed, *wishes):
    """A neighbor's number of segments, the smallest that is enough and not much too fine; else what is needed."""
    best = needed
    for wish in sorted(wishes, key=lambda wish: -wish.sum()):
        fits = (wish >= needed) & (wish <= LARGEST_REFINEMENT * needed)
        best = np.where(fits, wish, best)
    return best


def part_triangles(parts: Parts, batch: Batch) -> tuple[Batch, Batch]:
    """Fill the regular triangles of a batch and part the others: triangles and quadrilaterals to look at again."""
    counts = batch[5]
    low, high = counts.min(axis=1), counts.max(axis=1)
    regular = low == high
    parts.fill_triangles(_take(batch, regular))
    middle = counts.sum(axis=1) - low - high
    round_ = ~regular & (low >= 2) & (high <= 2 * low)
    pointed = ~regular & ~round_ & (2 * middle > high) & (middle >= 2)
    flat = ~regular & ~round_ & ~pointed
    triangles, quads = [], []
    if round_.any():
        triangles += _quarter(parts, _take(batch, round_))
    if pointed.any():
        # The short side last but one, opposite the first corner.
        triangle, quad = _behead(parts, _turned(_take(batch, pointed), (counts[pointed].argmin(axis=1) + 2) % 3))
        triangles.append(triangle)
        quads.append(quad)
    if flat.any():
        triangles += _bisect(parts, _turned(_take(batch, flat), counts[flat].argmax(axis=1)))
    return _join(triangles, 3), _join(quads, 4)


def _quarter(parts, batch):
    """Four triangles between the middles of the sides."""
    sides = _Sides(parts, batch)
    a, b, c = (sides.corner(k) for k in range(3))
    (ab, ab_first, ab_second), (bc, bc_first, bc_second), (ca, ca_first, ca_second) = (
        sides.cut(k, sides.counts[:, k] // 2) for k in range(3)
    )

    def line(start, stop, one, other):
        wish = np.where(one[2] == other[2], one[2], 0)
        return sides.line(start, stop, _snapped(sides.needed(start, stop), wish))

    at_a, from_a = line(ab, ca, ab_first, ca_second)
    at_b, from_b = line(bc, ab, bc_first, ab_second)
    at_c, from_c = line(ca, bc, ca_first, bc_second)
    return [
        sides.piece((a, ab, ca), (ab_first, at_a, ca_second)),
        sides.piece((ab, b, bc), (ab_second, bc_first, at_b)),
        sides.piece((ca, bc, c), (at_c, bc_second, ca_first)),
        sides.piece((ab, bc, ca), (from_b, from_c, from_a)),
    ]


def _behead(parts, batch):
    """A triangle at the first corner and a quadrilateral along the short side opposite of it."""
    sides = _Sides(parts, batch)
    a, b, c = (sides.corner(k) for k in range(3))
    ab, ab_first, ab_second = sides.cut(0, sides.counts[:, 0] // 2)
    ca, ca_first, ca_second = sides.cut(2, sides.counts[:, 2] - sides.counts[:, 2] // 2)
    there, back = sides.line(ab, ca, _snapped(sides.needed(ab, ca), sides.counts[:, 1]))
    triangle = sides.piece((a, ab, ca), (ab_first, there, ca_second))
    return triangle, sides.piece((ab, b, c, ca), (ab_second, sides.side(1), ca_first, back))


def _bisect(parts, batch):
    """Two triangles: the first side is cut in the middle."""
    sides = _Sides(parts, batch)
    a, b, c = (sides.corner(k) for k in range(3))
    ab, ab_first, ab_second = sides.cut(0, sides.counts[:, 0] // 2)
    there, back = sides.line(ab, c, sides.needed(ab, c))
    return [
        sides.piece((a, ab, c), (ab_first, there, sides.side(2))),
        sides.piece((ab, b, c), (ab_second, sides.side(1), back)),
    ]


def part_quads(parts: Parts, batch: Batch) -> tuple[Batch, Batch]:
    """Fill the regular quadrilaterals of a batch and part the others: what is to be looked at again."""
    counts = batch[5]
    regular = (counts[:, 0] == counts[:, 2]) & (counts[:, 1] == counts[:, 3])
    parts.fill_quads(_take(batch, regular))
    across, up = np.minimum(counts[:, 0], counts[:, 2]), np.minimum(counts[:, 1], counts[:, 3])
    longer = np.maximum(counts[:, 0], counts[:, 2]) >= np.maximum(counts[:, 1], counts[:, 3])
    halved = ~regular & ((across >= 2) | (up >= 2))
    other = ~regular & ~halved
    triangles, quads = [], []
    if halved.any():
        upright = ~np.where(across < 2, False, np.where(up < 2, True, longer))[halved]
        quads += _halve(parts, _turned(_take(batch, halved), upright.astype(np.int64)))
    if other.any():
        triangles += _fan(parts, _turned(_take(batch, other), counts[other].argmax(axis=1)))
    return _join(triangles, 3), _join(quads, 4)


def _halve(parts, batch):
    """Two quadrilaterals: the first and the third side are cut in the middle."""
    sides = _Sides(parts, batch)
    a, b, c, d = (sides.corner(k) for k in range(4))
    ab, ab_first, ab_second = sides.cut(0, sides.counts[:, 0] // 2)
    cd, cd_first, cd_second = sides.cut(2, sides.counts[:, 2] - sides.counts[:, 2] // 2)
    there, back = sides.line(ab, cd, _snapped(sides.needed(ab, cd), sides.counts[:, 1], sides.counts[:, 3]))
    return [
        sides.piece((a, ab, cd, d), (ab_first, there, cd_second, sides.side(3))),
        sides.piece((ab, b, c, cd), (ab_second, sides.side(1), cd_first, back)),
    ]


def _fan(parts, batch):
    """Three triangles around a vertex on the first side."""
    sides = _Sides(parts, batch)
    a, b, c, d = (sides.corner(k) for k in range(4))
    ab, ab_first, ab_second = sides.cut(0, sides.counts[:, 0] // 2)
    to_c, from_c = sides.line(ab, c, sides.needed(ab, c))
    to_d, from_d = sides.line(ab, d, sides.needed(ab, d))
    return [
        sides.piece((a, ab, d), (ab_first, to_d, sides.side(3))),
        sides.piece((ab, b, c), (ab_second, sides.side(1), from_c)),
        sides.piece((ab, c, d), (to_c, sides.side(2), from_d)),
    ]
