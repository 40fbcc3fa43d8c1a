"""Local environments: a scene cut by planes into convex cells, which see each other through portals only (survey 3).

A plane that a wall stands in is closed by that wall but for its doorways. So planes of large polygons are tried, and
the one that leaves the least work is taken: patches that exchange light with those of their own cell only, and with the
*portals*, the openings that are left in the plane. Cells are convex, polygons that cross a plane are cut, and a portal
has one cell on each side; so whatever leaves a cell passes a portal or leaves the scene.

Choose it for buildings: rooms joined by doors. A single hall stays one cell, as any cut would open more than it closes.

Cost: for each cell a test of the planes of its largest polygons against all its polygons, `CANDIDATES` at most. Limits:
planes only, so rooms that interlock need several cells each; an opening is as wide as the cell where no polygon closes
the plane, inside walls and outside the building too, which costs portals but no accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..environment import Environment
from ..errors import SettingsError
from ..visibility.convex_loops import convex_pieces, join, split
from .hierarchy import UNITS, Hierarchy, SubdivisionLimits
from .openings import IN_PLANE, SLIVER, loop_areas, openings_in, section

#: Planes of a cell that are tried, those first whose polygons are largest.
CANDIDATES = 48

#: Share of the work, as the number of pairs of patches, that a plane must save. With a tenth, a wall's inside became a
#: cell of its own, whose two portals only blur the light.
LEAST_GAIN = 0.2

#: Portals between two cells, unless a size is given. Black portals err by direction, not by place: the light behind a
#: doorway was 11.7 % off with 2 of them as with 96.
PORTALS = 4


@dataclass(frozen=True)
class Partition:
    """Cells of a scene; made by `partition` or `cut_at`.

    Attributes
    ----------
    environment : Environment
        The scene; two-sided polygons in a plane are two of its pieces.
    pieces : Environment
        Its polygons as cut, convex; n patches make q pieces.
    patches, cells : (q,) int64
        Patch and cell of each piece.
    portals : Environment or None
        Openings, facing the first of their cells; None where nothing is open.
    portal_cells : (p, 2) int64
        Cells in front of each portal and behind it.
    planes : (m, 4) float64
        Unit normal and offset of each plane: points x with ``normal @ x == offset`` lie in it.
    count : int
        Number of cells.
    """

    environment: Environment
    pieces: Environment
    patches: np.ndarray
    cells: np.ndarray
    portals: Environment | None
    portal_cells: np.ndarray
    planes: np.ndarray
    count: int


@dataclass
class _Cell:
    """A convex part of space, in the unit frame: convex loops (k, c, 3) in it, what they are, and the planes around."""

    loops: np.ndarray
    patches: np.ndarray
    faces: np.ndarray  # (k, 3) normals of the fronts
    two_sided: np.ndarray
    bounds: list[np.ndarray]  # planes (4,), the cell above each
    portals: list[int] = field(default_factory=list)


def partition(environment: Environment, portal_size: float | None = None, least: int = 32) -> Partition:
    """Cut a scene where walls leave small openings.

    Parameters
    ----------
    environment : Environment
    portal_size : float, optional
        Length, in scene units, above which portals are divided; by default two cells see each other through `PORTALS`
        of them, or some more.
    least : int
        Patches up to which a cell is not cut.

    Returns
    -------
    Partition

    References
    ----------
    .. [1] Xu, Peng, Liang, "Accelerated Radiosity Method for Complex Environments", Eurographics 1989: planes of
       boundary patches between local environments.
    """
    cutter = _Cutter(environment)
    pending, done = [cutter.whole], []
    while pending:
        cell = pending.pop()
        plane = _best_plane(cell, cutter.box) if len(np.unique(cell.patches)) > least else None
        if plane is None:
            done.append(cell)
        else:
            pending += cutter.cut(cell, plane)
    return cutter.result(done, portal_size)


def cut_at(environment: Environment, planes: np.ndarray, portal_size: float | None = None) -> Partition:
    """Cut a scene at given planes, each through all cells that it meets.

    Parameters
    ----------
    environment : Environment
    planes : (m, 4) float
        Normals, of any length, and offsets: points x with ``normal @ x == offset`` lie in the plane.
    portal_size : float, optional
        As in `partition`.

    Raises
    ------
    SettingsError
        If a plane is not finite or has no normal.
    """
    planes = np.array(planes, dtype=np.float64).reshape(-1, 4)
    lengths = np.linalg.norm(planes[:, :3], axis=1)
    if not (np.isfinite(planes).all() and (lengths > 0).all()):
        raise SettingsError("Planes of local environments need four finite numbers each, the normal not being 0")
    cutter = _Cutter(environment)
    cells = [cutter.whole]
    for plane in cutter.to_unit(planes / lengths[:, None]):
        cells = [part for cell in cells for part in cutter.cut(cell, plane)]
    return cutter.result(cells, portal_size)


def planes_between(environment: Environment, groups: np.ndarray) -> np.ndarray:
    """Axis-aligned planes (m, 4) that part groups of patches, such as the collections of a building's rooms.

    Parameters
    ----------
    environment : Environment
    groups : (n,) int
        Group of each patch; patches of a negative one are in none, and may lie on both sides.

    Raises
    ------
    SettingsError
        If no such plane parts two of the groups; the text names them.
    """
    groups = np.asarray(groups)
    if groups.shape != (len(environment),):
        raise SettingsError(f"Groups must be {len(environment)} numbers, one per patch, not of shape {groups.shape}")
    names = np.unique(groups[groups >= 0])
    low, high = np.empty((len(names), 3)), np.empty((len(names), 3))
    for row, name in enumerate(names):
        corners = np.concatenate([environment.polygons[patch] for patch in np.flatnonzero(groups == name)])
        low[row], high[row] = corners.min(axis=0), corners.max(axis=0)
    size = float(np.ptp(environment.vertices, axis=0).max())
    planes = []
    for one in range(len(names)):
        for other in range(one):
            gaps = np.stack((low[one] - high[other], low[other] - high[one]))
            sign, axis = np.unravel_index(gaps.argmax(), gaps.shape)
            if gaps[sign, axis] < -IN_PLANE * size:
                raise SettingsError(
                    f"Groups {names[other]} and {names[one]} overlap in every direction: no plane parts them"
                )
            normal = np.zeros(4)
            # A wall's own face, so that the wall closes the plane.
            normal[axis], normal[3] = 1, high[(other, one)[sign], axis]
            planes.append(normal)
    return np.unique(np.array(planes).reshape(-1, 4), axis=0)


class _Cutter:
    """Cells being cut, in the frame of the convex pieces, and the openings found so far."""

    def __init__(self, environment: Environment):
        self.environment = environment
        found = convex_pieces(environment)
        self.center, self.size = found.center, found.size
        self.openings: list[np.ndarray] = []  # (1, k, 3) loops, counter-clockwise seen from the first cell
        self.owners: list[list[_Cell]] = []
        self.planes: list[np.ndarray] = []
        points = found.loops.reshape(-1, 3)
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.zeros(3))
        self.box = [np.array([*row, row @ bound]) for bound, sign in ((low, 1), (high, -1)) for row in sign * np.eye(3)]
        self.whole = _Cell(
            found.loops, found.patches, found.normals, environment.two_sided[found.patches], list(self.box)
        )

    def to_unit(self, planes):
        """Planes (m, 4) of the scene in the unit frame."""
        offsets = (planes[:, 3] - planes[:, :3] @ self.center) / self.size
        return np.concatenate((planes[:, :3], offsets[:, None]), axis=1)

    def cut(self, cell: _Cell, plane: np.ndarray) -> list[_Cell]:
        """The cell's parts above and below a plane, or itself where all of it lies on one side."""
        heights = cell.loops @ plane[:3] - plane[3]
        if not ((heights > IN_PLANE).any() and (heights < -IN_PLANE).any()):
            return [cell]
        flat = (np.abs(heights) <= IN_PLANE).all(axis=1)
        opening = openings_in(cell.bounds, plane, cell.loops[flat])
        parts = _parts(cell, plane, heights, flat)
        self._share_portals(cell, parts, plane)
        for loop in opening:
            self.openings.append(loop[None])
            self.owners.append(list(parts))
            for part in parts:
                part.portals.append(len(self.openings) - 1)
        self.planes.append(plane)
        return parts

    def _share_portals(self, cell, parts, plane):
        """Portals of a cell that is cut become portals of its parts, cut where the plane meets them."""
        for portal in cell.portals:
            loop = self.openings[portal]
            above, _, below, _ = split(loop, loop @ plane[:3] - plane[3], IN_PLANE)
            other = [owner for owner in self.owners[portal]]
            side = next(place for place, owner in enumerate(other) if owner is cell)
            self.openings[portal], self.owners[portal] = None, []
            for part, pieces in zip(parts, (above, below), strict=True):
                for piece in pieces:
                    owners = list(other)
                    owners[side] = part
                    number = len(self.openings)
                    self.openings.append(piece[None])
                    self.owners.append(owners)
                    for owner in owners:
                        owner.portals.append(number)
            for owner in other:
                owner.portals = [number for number in owner.portals if number != portal]

    def result(self, cells: list[_Cell], portal_size: float | None) -> Partition:
        numbers = {id(cell): number for number, cell in enumerate(cells)}
        sizes = [len(cell.loops) for cell in cells]
        patches = np.concatenate([cell.patches for cell in cells])
        sides = np.concatenate([cell.two_sided for cell in cells])
        loops = [self._in_scene(loop) for cell in cells for loop in cell.loops]
        known = self.environment
        pieces = Environment.from_polygons(loops, known.reflectance[patches], known.emission[patches], sides)
        kept = [number for number, loop in enumerate(self.openings) if loop is not None]
        owners = np.array([[numbers[id(owner)] for owner in self.owners[number]] for number in kept]).reshape(-1, 2)
        portals, portal_cells = None, owners.astype(np.int64)
        if kept:
            openings = [self._in_scene(self.openings[number][0]) for number in kept]
            portals, chosen = _divided(openings, portal_cells, portal_size)
            portal_cells = portal_cells[chosen]
        planes = np.array(self.planes).reshape(-1, 4)
        planes[:, 3] = planes[:, 3] * self.size + planes[:, :3] @ self.center
        return Partition(
            known, pieces, patches, np.repeat(np.arange(len(cells)), sizes), portals, portal_cells, planes, len(cells)
        )

    def _in_scene(self, loop):
        """Corners (k, 3) of a padded loop of the unit frame, without those repeated."""
        distinct = (loop != np.roll(loop, 1, axis=0)).any(axis=1)
        return loop[distinct] * self.size + self.center


def _parts(cell, plane, heights, flat):
    """The parts above and below, with what lies in the plane where its front looks to."""
    above, up, below, down = split(cell.loops[~flat], heights[~flat], IN_PLANE)
    rows = np.flatnonzero(~flat)
    facing = cell.faces @ plane[:3] > 0
    parts = []
    for loops, chosen, sign in ((above, rows[up], 1), (below, rows[down], -1)):
        # A two-sided polygon in the plane has a side in each part.
        front = np.flatnonzero(flat & (facing == (sign > 0)))
        back = np.flatnonzero(flat & (facing != (sign > 0)) & cell.two_sided)
        everything = [loops, cell.loops[front], cell.loops[back][:, ::-1]]
        order = np.concatenate((chosen, front, back))
        part = _Cell(
            join(everything),
            cell.patches[order],
            np.concatenate((cell.faces[chosen], cell.faces[front], -cell.faces[back])),
            np.concatenate((cell.two_sided[chosen], np.zeros(len(front) + len(back), bool))),
            [*cell.bounds, sign * plane],
        )
        parts.append(part)
    return parts


def _best_plane(cell, box):
    """The plane (4,) that saves most pairs of patches; None where none saves `LEAST_GAIN` of them."""
    areas = loop_areas(cell.loops)
    normals = cell.faces
    # Planes whose normals point the other way are the same.
    leading = np.take_along_axis(normals, np.abs(normals).argmax(axis=1)[:, None], axis=1)
    offsets = np.einsum("ki,ki->k", normals, cell.loops[:, 0])
    planes = np.concatenate((normals, offsets[:, None]), axis=1) * np.sign(leading)
    _, first, group = np.unique(np.round(planes / IN_PLANE / 4), axis=0, return_index=True, return_inverse=True)
    totals = np.bincount(group.reshape(-1), areas)
    best, least = None, (1 - LEAST_GAIN) * float(len(cell.loops)) ** 2
    for row in first[np.argsort(-totals, kind="stable")[:CANDIDATES]]:
        plane = planes[row]
        heights = cell.loops @ plane[:3] - plane[3]
        flat = (np.abs(heights) <= IN_PLANE).all(axis=1)
        up, down = ((sign * heights > IN_PLANE).any(axis=1) for sign in (1, -1))
        if not (up.any() and down.any()):
            continue
        ahead = flat & (cell.faces @ plane[:3] > 0)
        counts = [up.sum() + ahead.sum(), down.sum() + (flat & ~ahead).sum()]
        # The section takes longest to find: not for planes that save too little even without an opening.
        if sum(float(count) ** 2 for count in counts) >= least:
            continue
        open_area = loop_areas(section(cell.bounds, plane)[None])[0] - areas[flat].sum()
        portals = PORTALS if open_area > SLIVER else 0
        share = max(open_area, 0) / max(areas.sum(), SLIVER)
        # A wide opening hides nothing: what is seen through it is exchanged pair by pair.
        through = 2 * counts[0] * counts[1] * min(8 * share, 1)
        work = sum(float(count + portals) ** 2 for count in counts) + through
        if work < least:
            best, least = plane, work
    return best


def _divided(openings, cells, size):
    """Openings divided into portals, and the opening (p,) of each; `cells` (m, 2) are those on its sides."""
    whole = Environment.from_polygons(openings, 0.0)
    longest = float(np.ptp(whole.vertices, axis=0).max())
    if size is None:
        _, doorways = np.unique(cells, axis=0, return_inverse=True)
        size = (float(np.median(np.bincount(doorways.reshape(-1), whole.areas))) / PORTALS) ** 0.5
    units = UNITS * size / longest
    limits = SubdivisionLimits(units, units / 4, units, units / 4, max_elements=2**20)
    tree = Hierarchy.build(whole, limits)
    nodes = tree.patch_nodes
    return tree.polygons(nodes), tree.surfaces[nodes]
