"""Point to point: form factors from distances to planes, at the vertices of patches (Nishita and Nakamae 1985).

A patch is a grid of vertices. The factor from a point to the small area that a vertex stands for is the product of the
two distances to each other's plane over pi r^4 (survey eq. 10), and a vertex weighs 1/4 in a corner, 1/2 on an edge and
1 inside. A row of vertices is tested for shadows at once, which `silhouettes` does exactly. This is the trapezoid rule
on the double integral: its error falls with the square of the spacing while patches are apart.

Choose it for scenes of boxes without a ray engine, for vertex radiosities, and as the plainest of formulas to test
others against. Cost: a few nanoseconds per pair of vertices, grids doubled pair by pair until the factor stands still.

Limits: where patches touch, the integrand is singular. The matrix takes points in the middles of cells, which never
coincide with vertices, and grids that are denser towards the borders, where patches touch; a point's factor is cut off
at 1. Contacts inside of a patch, as under a box on an undivided floor, still converge slowly: divide the floor there.

References
----------
.. [1] Nishita, Nakamae, "Continuous Tone Representation of Three-Dimensional Objects Taking Account of Shadows and
   Interreflection", SIGGRAPH 1985, eq. as in Pueyo's survey, eq. 10.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.convex_loops import is_convex, pad
from ..visibility.segments import make_visibility
from ..visibility.silhouettes import SilhouetteVisibility
from .faces import smaller_first
from .hemisphere import SampledRows
from .point_rows import PointRows
from .vertex_grid import cell_middles, grid_steps, quartered, vertex_grid

#: Cells per side of a patch in successive rounds.
CELLS = (1, 2, 4, 8, 16, 32)

#: Cells per side from which on a small change is believed where the factor is more than so many times the accuracy:
#: grids of 1 and 2 cells agreed by luck in a box with a cube, where both were 5 times the accuracy off.
TRUSTED_CELLS = 8
NEGLIGIBLE = 3

#: Ratios of successive changes that count as a geometric series: those of orders 1 and 2 are 1/2 and 1/4.
STEADY_FALL = (0.15, 0.65)

#: Pairs of points evaluated at once: temporaries near 60 MB.
BLOCK_POINTS = 2**20

#: For single points: cells per side of a part of a patch, quarterings of parts that are too near for the largest, and
#: cells per side of a part as wide as it is far, in inverse square roots of the relative error wanted.
POINT_CELLS = (1, 2, 4)
DEEPEST = 16
SPACING = 0.5

#: Squared distance, in squares of the coordinates' size, below which two points coincide and exchange nothing.
COINCIDENT = 1e-28

logger = logging.getLogger(__name__)


def point_to_vertices(
    points: np.ndarray, normals: np.ndarray, corners: np.ndarray, cells: int, visibility=None
) -> np.ndarray:
    """Factors from n differential areas to one patch by the vertex formula, as published: not cut off at 1.

    Parameters
    ----------
    points, normals : (n, 3) float
        Places and unit normals.
    corners : (3, 3) or (4, 3) float
        Triangle or convex quadrilateral, counter-clockwise seen from its front.
    cells : int
        Cells per side of its grid.
    visibility : Visibility or None
        Shadow function of the vertices; None sees all.

    Returns
    -------
    (n,) float64

    Raises
    ------
    SettingsError
        If the patch has other than 3 or 4 corners, or `cells` is below 1.
    """
    corners = np.asarray(corners, dtype=np.float64)
    if corners.shape not in ((3, 3), (4, 3)) or cells < 1:
        raise SettingsError("A grid of vertices needs a patch of 3 or 4 corners, and 1 cell or more per side")
    points, normals = np.asarray(points, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    quad = pad([corners, np.zeros((4, 3))])[:1]
    normal = np.cross(quad[0, 2] - quad[0, 0], quad[0, 3] - quad[0, 1])
    if len(corners) == 3:
        normal = np.cross(quad[0, 1] - quad[0, 0], quad[0, 2] - quad[0, 0])
    length = np.linalg.norm(normal)
    if not length > 0:
        return np.zeros(len(points))
    steps = grid_steps(cells)
    grid = _Grid(*vertex_grid(quad, steps), steps)
    factors = np.zeros(len(points))
    block = max(1, BLOCK_POINTS // (cells + 1) ** 2)
    for start in range(0, len(points), block):
        rows = slice(start, start + block)
        factors[rows] = _vertex_sums(
            points[None, rows], normals[None, rows], grid, normal[None] / length, (False, False), visibility
        )[0]
    return factors


@dataclass(frozen=True)
class _Grid:
    """Vertices (p, r, s, 3) by rows, their areas (p, r, s), and the places (s,) of the lines from 0 to 1."""

    vertices: np.ndarray
    areas: np.ndarray
    steps: np.ndarray


def _vertex_sums(points, normals, grid, source_normals, two_sided, visibility):
    """Sums (p, n) over vertices of each pair's source, for its points (p, n, 3)."""
    pairs, count = points.shape[:2]
    rows, columns = grid.areas.shape[1:]
    vertices = grid.vertices.reshape(pairs, rows * columns, 3)
    over, back, squares = (np.zeros((pairs, count, rows * columns)) for _ in range(3))
    for axis in range(3):
        ways = vertices[:, None, :, axis] - points[:, :, None, axis]
        over += ways * normals[:, :, None, axis]
        back -= ways * source_normals[:, None, None, axis]
        squares += ways * ways
    over, back = (np.abs(d) if both else np.maximum(d, 0) for d, both in zip((over, back), two_sided, strict=True))
    extent = np.abs(vertices).max(initial=0) ** 2
    squares[squares <= COINCIDENT * extent] = np.inf
    values = over * back / (np.pi * squares * squares) * grid.areas.reshape(pairs, 1, -1)
    if visibility is not None:
        values *= _seen(points, grid, values > 0, visibility)
    return values.sum(axis=2)


def _seen(points, grid, wanted, visibility):
    """(p, n, v) bool: which vertices are visible; a row at once where the visibility can."""
    pairs, count, total = wanted.shape
    vertices = grid.vertices
    rows, columns = vertices.shape[1:3]
    seen = np.zeros(wanted.shape, dtype=bool)
    if isinstance(visibility, SilhouetteVisibility):
        used = wanted.reshape(pairs, count, rows, columns).any(axis=3)
        pair, point, row = np.nonzero(used)
        ends = vertices[pair, row, 0], vertices[pair, row, -1]
        free = visibility.visible_rows(points[pair, point], *ends, grid.steps)
        seen.reshape(pairs, count, rows, columns)[pair, point, row] = free
        return seen
    pair, point, vertex = np.nonzero(wanted)
    targets = vertices.reshape(pairs, total, 3)[pair, vertex]
    seen[pair, point, vertex] = visibility.visible(points[pair, point], targets)
    return seen


def point_to_point_rows(environment, visibility, accuracy, seed=0, threads=0, cells=None) -> SampledRows:
    """Form factors of all patches by the vertex formula, grids refined pair by pair.

    Parameters
    ----------
    environment : Environment
    visibility : str
        ``silhouettes``, which test a row of vertices at once; ``none``, or any other that tests segments.
    accuracy : float
        Change by which the last doubling of a pair's grid may move its factor, extrapolated to an infinite grid.
    seed : int
        Nothing is random.
    threads : int
        Threads of the ray engine, where it is used.
    cells : int or None
        Cells per side of all patches, instead of refinement; the errors are then the change from half as many.

    Returns
    -------
    SampledRows

    Raises
    ------
    SettingsError
        If `cells` is below 1, or the visibility is unknown or cannot serve the environment.
    """
    if cells is not None and (int(cells) != cells or cells < 1):
        raise SettingsError(f"Cells per side of a patch must be a whole number from 1 on, not {cells}")
    integrator = _Integrator(
        environment, None if visibility == "none" else make_visibility(visibility, environment, threads)
    )
    levels = CELLS if cells is None else ((cells,) if cells == 1 else (max(cells // 2, 1), int(cells)))
    count, areas = len(environment), environment.areas
    receivers, sources = integrator.pairs()
    owners = integrator.patches[receivers], integrator.patches[sources]
    shares = integrator.areas[receivers] / integrator.patch_areas[owners[0]]
    smooth = ~integrator.shaded(receivers, sources)
    rounds = _Rounds(smooth & (cells is None))
    pending = np.arange(len(receivers))
    for level in levels:
        rounds.add(pending, integrator.factors(receivers[pending], sources[pending], int(level)) * shares[pending])
        if level != levels[0] and cells is None:
            early = (level < TRUSTED_CELLS) & (rounds.values[pending] > NEGLIGIBLE * accuracy)
            pending = pending[early | (rounds.errors[pending] > accuracy)]
        if not len(pending):
            break
    else:
        if cells is None:
            worst = rounds.errors.max()
            logger.warning("Form factors are accurate to %.2g only, not %.2g: grid limit", worst, accuracy)
    values, errors = rounds.values, rounds.errors
    matrix, changes = np.zeros((count, count)), np.zeros((count, count))
    np.add.at(matrix, owners, values)
    np.add.at(changes, owners, errors)
    matrix = np.minimum(matrix, 1)
    back = areas[:, None] / np.where(areas > 0, areas, 1)
    matrix, changes = matrix + (matrix * back).T, changes + changes.T
    escaped = np.maximum(1 - matrix.sum(axis=1), 0)
    return SampledRows(
        matrix,
        escaped,
        changes.max(axis=1, initial=0),
        np.ones(count, dtype=np.int64),
        integrator.tested,
        np.minimum(changes.sum(axis=1), 0.01),
    )


class _Rounds:
    """Factors on successive grids, each of half the spacing, and where they are heading.

    Changes fall by 4 from grid to grid where all is smooth, and less where patches touch. Shadows jump over vertices:
    factors with any are left as they come.
    The fall is measured, and the rest of its geometric series added (Aitken's process), where it is one.
    """

    def __init__(self, extrapolate: np.ndarray):
        self.extrapolate, count = extrapolate, len(extrapolate)
        self.plain, self.changes = np.zeros(count), np.zeros(count)
        self.values, self.errors = np.zeros(count), np.full(count, np.inf)

    def add(self, rows: np.ndarray, factors: np.ndarray) -> None:
        """Take the factors of some rows on their next grid."""
        changes = factors - self.plain[rows]
        before = self.changes[rows]
        fall = np.where(before != 0, changes / np.where(before != 0, before, 1), 0)
        series = (fall > STEADY_FALL[0]) & (fall < STEADY_FALL[1]) & self.extrapolate[rows]
        fall = np.where(series, fall, 0)
        values = factors + changes * fall / (1 - fall)
        # What is missing of a series of order 1 is as large as its last change; twice that leaves room for shadows.
        self.errors[rows] = np.abs(values - self.values[rows]) * np.where(series, 1, 2)
        self.values[rows] = np.maximum(values, 0)
        self.plain[rows], self.changes[rows] = factors, changes


class _Integrator:
    """Quadrilaterals of an environment's patches, and factors between them."""

    def __init__(self, environment: Environment, visibility):
        self.environment, self.visibility = environment, visibility
        loops, patches = [], []
        for patch in np.flatnonzero(environment.areas > 0):
            polygon = environment.polygons[patch]
            if len(polygon) <= 4 and is_convex(polygon, environment.normals[patch]):
                parts = [polygon]
            else:
                parts = list(environment.vertices[environment.triangles[environment.triangle_patches == patch]])
            loops += parts
            patches += [patch] * len(parts)
        self.corners = pad([*loops, np.zeros((4, 3))])[:-1]
        self.patches = np.array(patches, dtype=np.int64)
        self.normals = environment.normals[self.patches]
        self.areas = vertex_grid(self.corners, grid_steps(1))[1].sum(axis=(1, 2))
        self.patch_areas = np.bincount(self.patches, self.areas, len(environment))
        self.two_sided = environment.two_sided[self.patches]

    @property
    def tested(self) -> int:
        """Segments tested so far."""
        return 0 if self.visibility is None else self.visibility.rays

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of quadrilaterals that face each other, the one of the smaller patch as the receiver."""
        first, second = [], []
        for row in range(len(self.corners)):
            others = np.arange(row + 1, len(self.corners))
            others = others[self.patches[others] != self.patches[row]]
            over = (self.corners[others] - self.corners[row, 0]) @ self.normals[row]
            back = np.einsum("oki,oi->ok", self.corners[row] - self.corners[others, :1], self.normals[others])
            seen = (over.max(axis=1) > 0) | self.two_sided[row]
            seen &= (back.max(axis=1) > 0) | self.two_sided[others]
            second.append(others[seen])
            first.append(np.full(len(second[-1]), row))
        first, second = np.concatenate([*first, []]).astype(int), np.concatenate([*second, []]).astype(int)
        areas = self.environment.areas[self.patches]
        return smaller_first(areas, first, second)

    def shaded(self, receivers, sources):
        """(p,) bool: whether something may stand between pairs of quadrilaterals."""
        if self.visibility is None:
            return np.zeros(len(receivers), dtype=bool)
        if isinstance(self.visibility, SilhouetteVisibility):
            return self.visibility.between(np.concatenate((self.corners[receivers], self.corners[sources]), axis=1))
        return np.ones(len(receivers), dtype=bool)

    def factors(self, receivers, sources, cells):
        """Factors (p,) from quadrilaterals to others on grids of `cells` per side."""
        factors = np.zeros(len(receivers))
        block = max(1, BLOCK_POINTS // (cells * (cells + 1)) ** 2)
        for start in range(0, len(receivers), block):
            rows = slice(start, start + block)
            factors[rows] = self._block(receivers[rows], sources[rows], cells)
        return factors

    def _block(self, receivers, sources, cells):
        factors = np.zeros(len(receivers))
        hidden = self.shaded(receivers, sources)
        sides = self.two_sided[receivers].astype(int) * 2 + self.two_sided[sources]
        for key in np.unique(sides * 2 + hidden):
            chosen = np.flatnonzero(sides * 2 + hidden == key)
            here, there = receivers[chosen], sources[chosen]
            two_sided = (bool(key & 4), bool(key & 2))
            steps = grid_steps(cells, graded=True)
            points, areas = cell_middles(self.corners[here], steps)
            points, areas = points.reshape(len(here), -1, 3), areas.reshape(len(here), -1)
            normals = np.repeat(self.normals[here, None], points.shape[1], axis=1)
            grid = _Grid(*vertex_grid(self.corners[there], steps), steps)
            visibility = self.visibility if key & 1 else None
            sums = _vertex_sums(points, normals, grid, self.normals[there], two_sided, visibility)
            # Half of the power of a two-sided patch leaves on either side.
            sums = np.minimum(sums * (0.5 if two_sided[0] else 1.0), 1)
            factors[chosen] = (sums * areas).sum(axis=1) / self.areas[here]
        return factors

    def facing(self, points, normals, sources, corners):
        """(m,) bool: whether something of each part of a source, with corners (m, 4, 3), is before its point."""
        rays = corners - points[:, None]
        back = -np.einsum("mi,mi->m", rays[:, 0], self.normals[sources])
        return (np.einsum("mki,mi->mk", rays, normals).max(axis=1) > 0) & ((back > 0) | self.two_sided[sources])

    def from_points(self, points, normals, sources, corners, cells):
        """Factors (m,) from points to parts of a source each, with corners (m, 4, 3), on grids of `cells` per side."""
        factors, steps = np.zeros(len(points)), grid_steps(cells)
        block = max(1, BLOCK_POINTS // (cells + 1) ** 2)
        for start in range(0, len(points), block):
            part = slice(start, start + block)
            grid, facing = _Grid(*vertex_grid(corners[part], steps), steps), self.normals[sources[part]]
            # Seen from behind, a two-sided source looks the other way.
            side = np.einsum("mi,mi->m", points[part] - corners[part, 0], facing)
            facing = np.where(side < 0, -1.0, 1.0)[:, None] * facing
            sums = _vertex_sums(points[part, None], normals[part, None], grid, facing, (False, False), self.visibility)
            factors[part] = sums[:, 0]
        return np.minimum(factors, 1)


def point_to_point_points(
    environment: Environment, visibility: str, accuracy: float, seed: int = 0, threads: int = 0
) -> PointRows:
    """Factors from points to all patches by the vertex formula, on grids that are finer the nearer the patch is.

    Parameters
    ----------
    environment : Environment
    visibility : str
        Any that tests segments.
    accuracy : float
        Relative error wanted of each factor. That of a grid is about the square of spacing over distance.
    seed : int
        Nothing is random.
    threads : int
        Threads of the ray engine, where it is used.

    Returns
    -------
    PointRows

    Raises
    ------
    SettingsError
        If the visibility is unknown or cannot serve the environment.
    """
    integrator = _Integrator(environment, make_visibility(visibility, environment, threads))
    count, quads = len(environment), len(integrator.corners)

    def rows(points: np.ndarray, normals: np.ndarray, names: np.ndarray) -> np.ndarray:
        out = np.zeros((len(points), count))
        which, source = (index.ravel() for index in np.indices((len(points), quads)))
        corners = integrator.corners[source]
        for depth in range(DEEPEST + 1):
            lit = integrator.facing(points[which], normals[which], source, corners)
            which, source, corners = which[lit], source[lit], corners[lit]
            cells = cells_wanted(points[which], corners, accuracy)
            if depth == DEEPEST:
                cells = np.minimum(cells, POINT_CELLS[-1])
            for level in POINT_CELLS:
                chosen = np.flatnonzero((cells <= level) & (2 * cells > level))
                factors = integrator.from_points(
                    points[which[chosen]], normals[which[chosen]], source[chosen], corners[chosen], level
                )
                np.add.at(out, (which[chosen], integrator.patches[source[chosen]]), factors)
            near = np.flatnonzero(cells > POINT_CELLS[-1])
            if not len(near):
                break
            which, source, corners = np.repeat(which[near], 4), np.repeat(source[near], 4), quartered(corners[near])
        return np.minimum(out, 1)

    return rows


def cells_wanted(points: np.ndarray, corners: np.ndarray, accuracy: float) -> np.ndarray:
    """(m,) cells per side, 1 or more, that quadrilaterals (m, 4, 3) need as seen from points (m, 3)."""
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    nearest = np.maximum(np.linalg.norm(points - middles, axis=1) - radii, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = 2 * SPACING / accuracy**0.5 * radii / nearest
    return 2.0 ** np.ceil(np.log2(np.where(radii > 0, np.maximum(wanted, 1), 1)))
