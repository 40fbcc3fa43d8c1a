"""Hybrid: analytic factors everywhere, projection or rays only to tell what is visible (Baum 1989).

Pairs that nothing can come between take the contour integral, and no visibility is tested. Of the others the source is
cut, as seen from points of the receiver, until each piece is wholly visible or wholly hidden; visible pieces count with
the closed form of a point and a polygon, which a hemicube's delta factors only approach. How a piece is judged is the
`detection`: by an item buffer around the point, or by rays, toward its corners and center, which must agree. Pieces
too small to be cut further count by the share of random places, one in each quarter, that are seen.

The hemicube's assumptions fail for sources that are near for their size, where few pixels decide over much of the
factor, and an error of a bright source weighs as much as its light; so both are cut further than others. The sum over
pieces yields the visible share of the pair, which multiplies the exact factor of the contour integral.

Choose it where shadows matter and factors shall be smooth in what is unshadowed. Cost: some ten to hundred tests for
each point and blocked source. Limits: a blocker that falls between all tests of all points is overlooked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.segments import Visibility, make_visibility
from .cells import Cells
from .contour_integral import face_block
from .faces import Faces, smaller_first
from .hemisphere import SampledRows
from .pair_rows import pair_rows
from .plane_clipping import clip_loops
from .point_rows import PointRows
from .point_to_polygon import lambert_sum
from .receivers import FaceCells, face_cells
from .sampling import PatchSampler, kronecker_points, kronecker_steps

#: Kinds of detection, and the visibility each uses.
DETECTIONS = {"item_buffer": "zbuffer", "rays": "embree"}

#: Pixels along a side of the item buffer: pieces are tested exactly against what these show.
RESOLUTION = 64

#: Points of the receiver, levels of quartering before a piece may be called wholly visible or hidden, and at most, for
#: about so many segments of a pair as `visible_share` asks for. A piece of the last level that is still mixed counts by
#: the share of its tests that pass.
POINTS_AND_LEVELS = (
    (2, 1, 0, 1),
    (8, 1, 1, 2),
    (32, 2, 2, 3),
    (128, 2, 3, 3),
    (512, 8, 3, 3),
    (2048, 32, 3, 3),
    (8192, 128, 3, 3),
    (32768, 512, 3, 3),
)

#: Steps by which the places of tests are turned from point to point, and from quarter to quarter: of two sequences, so
#: that points and quarters together do not come back to the same places.
POINT_TURN, QUARTER_TURN = kronecker_steps(2), kronecker_steps(3)[:2]

#: Levels more for sources that are near or bright.
MORE_LEVELS = 1

#: Distance in radii below which a source is near: at it, the hemicube's error of taking it as far is about a percent.
NEAR = 5.0

#: Share of the greatest power of a source from which on it is bright.
BRIGHT = 0.1

#: Share of its size by which the tested corners of a piece lie within it: its border may be a blocker's foot.
INWARD = 0.02

#: Points times pieces in hand at once.
BLOCK_PIECES = 2**16

#: For single points: quarterings at most, and the factors, over the relative error wanted, below which a piece that is
#: partly visible, or seems to be wholly so or not at all, is not cut further.
POINT_LEVELS = 4
POINT_SHARE = 0.05
UNTESTED = 0.5


def hybrid_rows(
    environment: Environment,
    visibility: str = "embree",
    accuracy: float = 1e-3,
    seed: int = 0,
    threads: int = 0,
    detection: str | None = None,
) -> SampledRows:
    """Form factors of all patches.

    Parameters
    ----------
    environment : Environment
        Its emission tells which sources are bright.
    visibility : str
        Any that tests segments; that of `detection`, where it is given.
    accuracy : float
        Error wanted.
    seed, threads : int
    detection : str, optional
        ``item_buffer`` or ``rays``.

    Returns
    -------
    SampledRows

    Raises
    ------
    SettingsError
        If the detection is unknown.

    References
    ----------
    .. [1] Baum, Rushmeier, Winget, "Improving Radiosity Solutions Through the Use of Analytically Determined
       Form-Factors", SIGGRAPH 1989.
    """
    if detection is not None and detection not in DETECTIONS:
        raise SettingsError(f"Unknown detection {detection!r}: choose {', '.join(DETECTIONS)}")
    faces = Faces(environment)
    name = DETECTIONS.get(detection, visibility)
    options = {"resolution": RESOLUTION} if name == "zbuffer" else {}
    sight = make_visibility(name, environment, threads, **options)

    def unoccluded(rows, columns, wanted):
        return face_block(faces, rows, columns, 0.0, wanted)

    return pair_rows(environment, faces, unoccluded, PieceSamples(environment, faces, sight), accuracy, seed)


class PieceSamples:
    """Pieces of one face seen from points of the other, as of `visible_share.Samples`.

    The points are on the smaller face: from it the other's shadow is sharper, and they lie closer together.

    Parameters
    ----------
    environment : Environment
        Its emission tells which sources are bright.
    faces : Faces
        Its faces.
    visibility : Visibility
    """

    def __init__(self, environment: Environment, faces: Faces, visibility: Visibility):
        self.faces, self.visibility = faces, visibility
        self.sampler = PatchSampler(environment)
        self.cells = FaceCells(environment, faces)
        power = (environment.emission.max(axis=1) * environment.areas)[faces.owners]
        self.bright = (power > 0) & (power >= BRIGHT * power.max(initial=0))

    def __call__(
        self, first: np.ndarray, second: np.ndarray, count: int, shifts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weights of what is visible and of all, (m,) each: see `Samples`."""
        faces = self.faces
        first, second = smaller_first(faces.areas, first, second)
        number, least, most = next(row[1:] for row in POINTS_AND_LEVELS if count <= row[0])
        # Reciprocity carries the factor over, so the bright source may be either of the two.
        apart = np.linalg.norm(faces.centers[first] - faces.centers[second], axis=1)
        near = apart < NEAR * faces.radii[second]
        last = most + MORE_LEVELS * (near | self.bright[first] | self.bright[second])
        seen, whole = np.zeros((2, len(first)))
        step = max(1, BLOCK_PIECES // (number * 4**least))
        for begin in range(0, len(first), step):
            part = slice(begin, begin + step)
            square = (kronecker_points(number, 2) + shifts[part, None, :2]) % 1
            points = self.sampler(faces.owners[first[part]], square).reshape(-1, 3)
            pair = np.repeat(np.arange(len(square)), number)
            which, cells = self.cells.of(second[part][pair])
            turns = (shifts[part, 2:][pair] + np.outer(np.arange(len(points)) % number, POINT_TURN)) % 1
            work = _Pieces(which, cells, turns[which])
            sums = self._cut(work, points, faces.normals[first[part]][pair], least, last[part][pair])
            for total, found in zip((seen, whole), sums, strict=True):
                total[part] = found.reshape(-1, number).sum(axis=1)
        return seen, whole

    def _cut(self, work, points, normals, least, last):
        """What each point (n,) sees of its pieces, and the whole of them; `last` (n,) is the level of the finest."""
        seen, whole = np.zeros((2, len(points)))
        for level in range(last.max(initial=0) + 1):
            factors = piece_factors(points[work.which], normals[work.which], work.cells)
            rows = np.flatnonzero(factors > 0)
            work, factors = work.take(rows), factors[rows]
            if not len(rows):
                break
            done, passed = np.zeros(len(rows), bool), np.zeros(len(rows))
            if level >= least:
                passed = _seen_ends(points[work.which], work.cells, self.visibility)
                done = (passed == 0) | (passed == 1) | (level >= last[work.which])
                mixed = np.flatnonzero(done & (passed > 0) & (passed < 1))
                passed[mixed] = _seen_quarters(
                    points[work.which[mixed]], work.cells[mixed], self.visibility, work.places[mixed]
                )
            whole += np.bincount(work.which[done], factors[done], len(points))
            seen += np.bincount(work.which[done], factors[done] * passed[done], len(points))
            work = work.quartered(np.flatnonzero(~done))
        return seen, whole


@dataclass(frozen=True)
class _Pieces:
    """Pieces of sources, the point that each is seen from, and numbers (w, 2) from 0 to 1 that choose places on it."""

    which: np.ndarray
    cells: Cells
    places: np.ndarray

    def take(self, rows):
        """Some of the pieces."""
        return _Pieces(self.which[rows], self.cells[rows], self.places[rows])

    def quartered(self, rows):
        """Some of the pieces, each in four."""
        turns = np.tile(np.outer(np.arange(4), QUARTER_TURN), (len(rows), 1))
        return _Pieces(
            np.repeat(self.which[rows], 4),
            self.cells[rows].divided(2),
            (np.repeat(4 * self.places[rows], 4, axis=0) + turns) % 1,
        )


def _seen_ends(points, pieces, sight):
    """Share (w,) of the corners and the center of each piece that its point sees."""
    near, far = INWARD, 1 - INWARD
    square = np.array([[near, near], [far, near], [near, far], [far, far], [0.5, 0.5]])
    triangle = np.array([[near, near], [far - near, near], [near, far - near], [0.5 - near / 2] * 2, [1 / 3, 1 / 3]])
    places = np.where(pieces.triangular[:, None, None], triangle, square)
    targets = pieces.origins[:, None] + places[:, :, :1] * pieces.u[:, None] + places[:, :, 1:] * pieces.v[:, None]
    seen = sight.visible(np.repeat(points, len(square), axis=0), targets.reshape(-1, 3))
    return seen.reshape(-1, len(square)).mean(axis=1)


def _seen_quarters(points, pieces, sight, places):
    """Share (w,) of the quarters of each piece that its point sees, each at a random place (w, 2) from 0 to 1."""
    quarters = pieces.divided(2)
    turns = np.tile(np.outer(np.arange(4), QUARTER_TURN), (len(pieces), 1))
    targets = quarters.points((np.repeat(places, 4, axis=0) + turns) % 1)
    return sight.visible(np.repeat(points, 4, axis=0), targets).reshape(-1, 4).mean(axis=1)


def piece_factors(points: np.ndarray, normals: np.ndarray, pieces: Cells) -> np.ndarray:
    """Closed-form factor (w,) from each point and unit normal (w, 3) to its own piece, cut at the horizon."""
    third = pieces.u + np.where(pieces.triangular[:, None], 0, pieces.v)
    ends = [0 * pieces.u, pieces.u, np.where(pieces.triangular[:, None], pieces.v, third), pieces.v]
    rays = np.stack(ends, axis=1) + (pieces.origins - points)[:, None]
    front = -np.einsum("wi,wi->w", rays[:, 0], np.cross(pieces.u, pieces.v)) > 0
    heights = np.einsum("wki,wi->wk", rays, normals)
    factors = np.zeros(len(points))
    rows = np.flatnonzero(front & (heights > 0).any(axis=1))
    loops = clip_loops(rays[rows], heights[rows]).transpose(2, 1, 0)
    following = np.roll(loops, -1, axis=1)
    crosses = [loops[i] * following[j] - loops[j] * following[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    cosines = np.einsum("ikw,ikw->kw", loops, following)
    # A repeated corner at the point itself would make 0 / 0.
    cosines[cosines == 0] = np.finfo(np.float64).tiny
    factors[rows] = lambert_sum(crosses, normals[rows].T, None, cosines).clip(0, 1)
    return factors


def hybrid_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches: the closed form of each piece that is visible.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments.
    accuracy : float
        Relative error wanted of the light that a point gathers. Pieces are cut while they are mixed and their factor
        is above `POINT_SHARE` of it, or may hide something and are above `UNTESTED` of it.
    seed : int
        Of the tests of the last pieces.
    threads : int
        Threads of the ray engine, where it is used.

    Returns
    -------
    PointRows
    """
    faces = Faces(environment)
    cells = face_cells(environment, faces)
    owners = faces.owners[cells.patches]
    sight = make_visibility(visibility, environment, threads)
    count = len(environment)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        generator = np.random.default_rng((seed, int(names[0])))
        which, cell = (index.ravel() for index in np.indices((len(points), len(cells))))
        work, keys = cells[cell], which * count + owners[cell]
        out = np.zeros(len(points) * count)
        for level in range(POINT_LEVELS + 1):
            factors = piece_factors(points[which], normals[which], work)
            lit = np.flatnonzero(factors > 0)
            which, work, keys, factors = which[lit], work[lit], keys[lit], factors[lit]
            passed = _seen_ends(points[which], work, sight)
            even = (passed == 0) | (passed == 1)
            done = np.where(even, factors <= UNTESTED * accuracy, factors <= POINT_SHARE * accuracy)
            if level == POINT_LEVELS:
                done[:] = True
            mixed = np.flatnonzero(done & ~even)
            passed[mixed] = _seen_quarters(points[which[mixed]], work[mixed], sight, generator.random((len(mixed), 2)))
            out += np.bincount(keys[done], factors[done] * passed[done], len(out))
            which, keys, work = np.repeat(which[~done], 4), np.repeat(keys[~done], 4), work[~done].divided(2)
            if not len(which):
                break
        return np.minimum(out, 1).reshape(len(points), count)

    return rows
