"""Scenes of polygons for the comparison of form factors, each with factors to compare with.

Three sources of truth, in this order: the published reference data of the tests, where the scene is in it; the contour
integral, which is exact, where nothing can come between; else the closed form with exact clipping (``bsp``), finer than
any method compared. Factors are compared between *surfaces*, which consist of one patch or several.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from radiosity import core

REFERENCE_DATA = Path(__file__).parents[1] / "tests" / "reference" / "form_factors.json"

#: Accuracy of computed references: a tenth of the finest that is compared.
REFERENCE_ACCURACY = 1e-5

#: How far corners of a file's polygon may lie off its plane, in polygon sizes, before it is cut into triangles: a tenth
#: of what an environment accepts.
FLAT = 1e-6


@dataclass(frozen=True)
class Scene:
    """Patches, the surface that each belongs to, and the factors between surfaces, NaN where unknown."""

    name: str
    environment: core.Environment
    owners: np.ndarray  # (n,) int
    factors: np.ndarray  # (s, s)
    uncertainty: float
    source: str
    occluded: bool

    def surface_factors(self, matrix: np.ndarray) -> np.ndarray:
        """Factors between surfaces (s, s) from those between patches (n, n)."""
        members = (self.owners[:, None] == np.arange(len(self.factors))).astype(float)
        areas = members.T @ self.environment.areas
        exchange = members.T @ (self.environment.areas[:, None] * matrix) @ members
        return exchange / np.where(areas > 0, areas, 1)[:, None]


def published(name: str, case_id: str, occluded: bool) -> Scene:
    """Scene of a case of the reference data."""
    cases = json.loads(REFERENCE_DATA.read_text(encoding="utf-8"))["cases"]
    case = next(case for case in cases if case["id"] == case_id)
    surfaces = case["surfaces"]
    polygons = [np.array(polygon, dtype=float) for surface in surfaces for polygon in surface["polygons"]]
    owners = np.repeat(np.arange(len(surfaces)), [len(surface["polygons"]) for surface in surfaces])
    names = {surface["name"]: row for row, surface in enumerate(surfaces)}
    factors = np.full((len(surfaces), len(surfaces)), np.nan)
    if "matrix" in case:
        rows = [names[surface] for surface in case["matrix"]["order"]]
        factors[np.ix_(rows, rows)] = case["matrix"]["F"]
        uncertainty = case["matrix"]["abs_err"]
    else:
        for pair in case["expected"]:
            factors[names[pair["from"]], names[pair["to"]]] = pair["F"]
        uncertainty = max(pair["abs_err"] for pair in case["expected"])
    environment = core.Environment.from_polygons(polygons)
    return Scene(name, environment, owners, factors, uncertainty, f"reference data, {case_id}", occluded)


def computed(name: str, polygons: list[np.ndarray]) -> Scene:
    """Scene whose factors are computed by exact clipping, each patch a surface of its own."""
    environment = core.Environment.from_polygons(polygons)
    begin = time.perf_counter()
    result = core.form_factors(environment, "point_to_polygon", "bsp", REFERENCE_ACCURACY)
    source = f"point_to_polygon with bsp at {REFERENCE_ACCURACY:g}, {time.perf_counter() - begin:.0f} s"
    return Scene(
        name, environment, np.arange(len(polygons)), result.matrix, max(result.estimated_error, 1e-16), source, True
    )


def rectangle(corners: Iterable, divisions: int = 1) -> list[np.ndarray]:
    """Cells of a rectangle of four corners, counter-clockwise from the front."""
    first, second, _, last = np.asarray(corners, dtype=float)
    along, across = (second - first) / divisions, (last - first) / divisions
    loop = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    return [
        first + (cell + loop) @ np.array([along, across])
        for cell in map(np.array, itertools.product(range(divisions), repeat=2))
    ]


def divided(polygons: Iterable[np.ndarray], divisions: int | float, triangles: bool = False) -> list[np.ndarray]:
    """Cells of triangles and of convex quadrilaterals, in their order.

    Parameters
    ----------
    polygons : iterable of (3, 3) or (4, 3) float
    divisions : int or float
        Cells along each side; as a float the length of a cell that is not to be exceeded.
    triangles : bool
        Whether cells with four corners are cut into two triangles.
    """
    return [cell for polygon in polygons for cell in _cells(np.asarray(polygon, dtype=float), divisions, triangles)]


def _cells(polygon, divisions, triangles):
    along, across = polygon[1] - polygon[0], polygon[-1] - polygon[0]
    # Of a convex quadrilateral cells are images of a square's; of a triangle those of half a square.
    twist = polygon[2] - polygon[1] - across if len(polygon) == 4 else np.zeros(3)
    if isinstance(divisions, int):
        columns = rows = divisions
    else:
        columns, rows = (max(1, int(np.ceil(np.linalg.norm(side) / divisions))) for side in (along, across))
    if len(polygon) == 3:
        columns = rows = max(columns, rows)
    cells = []
    for i, j in itertools.product(range(columns), range(rows)):
        corners = np.array([(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]) / (columns, rows)
        if len(polygon) == 3:
            loops = (corners[[0, 1, 3]], corners[[1, 2, 3]])[: max(rows - i - j, 0)]
        else:
            loops = (corners[:3], corners[[0, 2, 3]]) if triangles else (corners,)
        cells += [polygon[0] + loop @ np.array([along, across]) + loop.prod(axis=1)[:, None] * twist for loop in loops]
    return cells


def box(low, high, inward: bool = False, divisions: int = 1, without: tuple[int, ...] = ()) -> list[np.ndarray]:
    """Sides of a box, seen from outside or inside; `without` names sides of -x, +x, -y, +y, -z, +z as 0 to 5."""
    ends = np.array([low, high], dtype=float)
    sides = []
    for side in sorted(set(range(6)) - set(without)):
        axis, end = divmod(side, 2)
        picks = np.zeros((4, 3), dtype=int)
        picks[:, axis] = end
        picks[:, (axis + 1) % 3], picks[:, (axis + 2) % 3] = (0, 1, 1, 0), (0, 0, 1, 1)
        corners = ends[picks, np.arange(3)]
        sides += rectangle(corners if (end == 1) != inward else corners[[0, 3, 2, 1]], divisions)
    return sides


def furnished_room() -> Scene:
    """A closed room of four patches a side with furniture."""
    return computed("furnished_room", box((0, 0, 0), (5, 4, 2.6), inward=True, divisions=2) + furniture())


def furniture() -> list[np.ndarray]:
    """A cupboard, a bed, a table board and a stool, all boxes, in a room of 5 x 4 x 2.6."""
    standing = (4,)
    polygons = box((0.3, 2.9, 0), (1.9, 3.6, 2.1), without=standing)
    polygons += box((2.7, 0.4, 0), (4.7, 1.4, 0.5), without=standing)
    polygons += box((1.2, 1.1, 0.7), (2.4, 1.9, 0.75))
    return polygons + box((1.6, 2.1, 0), (2.0, 2.5, 0.45), without=standing)


def read_obj(path: Path) -> list[np.ndarray]:
    """Polygons of a Wavefront OBJ file; bent ones are cut into triangles, those without area left out."""
    vertices, polygons = [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            numbers = [int(word.split("/")[0]) for word in words[1:]]
            loop = np.array([vertices[number - 1 if number > 0 else number] for number in numbers])
            polygons += [loop] if _is_flat(loop) else [loop[[0, i, i + 1]] for i in range(1, len(loop) - 1)]
    return [polygon for polygon in polygons if np.linalg.norm(_area_vector(polygon)) > FLAT * np.ptp(polygon) ** 2]


def _area_vector(loop: np.ndarray) -> np.ndarray:
    local = loop - loop[0]
    return np.cross(local[:-1], local[1:]).sum(axis=0) / 2


def _is_flat(loop: np.ndarray) -> bool:
    vector = _area_vector(loop)
    length = np.linalg.norm(vector)
    size = np.ptp(loop, axis=0).max()
    return length == 0 or np.abs((loop - loop[0]) @ vector).max() <= FLAT * size * length


def scene_from_file(path: Path, patches: int) -> Scene:
    """Scene of the largest polygons of an OBJ file; all others are left out, as patches and as blockers."""
    polygons = read_obj(path)
    sizes = np.array([np.linalg.norm(_area_vector(polygon)) for polygon in polygons])
    kept = np.sort(np.argsort(-sizes, kind="stable")[:patches])
    print(f"{path.name}: {len(kept)} of {len(polygons)} polygons, {sizes[kept].sum() / sizes.sum():.1%} of the area")
    return computed(path.stem, [polygons[row] for row in kept])


#: Scenes by name; a file adds one more.
SCENES: dict[str, Callable[[], Scene]] = {
    "facing_plates": lambda: published("facing_plates", "ff-par-1-1-1", occluded=False),
    "touching_plates": lambda: published("touching_plates", "ff-perp-1-1-1", occluded=False),
    "occluded_plates": lambda: published("occluded_plates", "obs-centre-mid", occluded=True),
    "cornell_box": lambda: published("cornell_box", "enc-cornell", occluded=True),
    "furnished_room": furnished_room,
}
