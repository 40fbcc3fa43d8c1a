"""Lit scenes of polygons for the comparison of solvers: surfaces as given, which strategies divide."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
from radiosity import core
from radiosity.core.discretization.hierarchy import UNITS, Hierarchy, SubdivisionLimits

from .form_factor_scenes import REFERENCE_DATA, box, furniture

WHITE, WOOD, RED, BLACK = (0.75, 0.75, 0.72), (0.5, 0.32, 0.18), (0.6, 0.25, 0.2), (0.0, 0.0, 0.0)

#: Exitance of a lamp's lower side, of the sides of its box the last but one.
LAMP = (12.0, 11.0, 9.0)


def cornell_box() -> core.Environment:
    """The published Cornell box with its front open, each polygon a surface: 33 of them."""
    factors = json.loads(REFERENCE_DATA.read_text(encoding="utf-8"))["cases"]
    lit = json.loads((REFERENCE_DATA.parent / "solutions.json").read_text(encoding="utf-8"))["cases"]
    room = next(case for case in factors if case["id"] == "enc-cornell")
    light = next(case for case in lit if case["id"] == "cornell-rgb")
    names = [surface["name"] for surface in room["surfaces"] for _ in surface["polygons"]]
    return core.Environment.from_polygons(
        [np.array(polygon) for surface in room["surfaces"] for polygon in surface["polygons"]],
        np.array([light["reflectance"][name] for name in names]),
        np.array([light["emission"][name] for name in names]),
    )


def furnished_room() -> core.Environment:
    """A closed room of 5 x 4 x 2.6 m with a cupboard, a bed, a table board and a stool, and one lamp."""
    return _lit([(box((0, 0, 0), (5, 4, 2.6), inward=True), WHITE), (furniture(), WOOD)], (1.9, 1.6), (2.7, 2.2))


def two_rooms() -> core.Environment:
    """Two closed rooms of 4 x 4 x 2.6 m and a doorway between them; the lamp hangs in one."""
    partition = box((4, 0, 0), (4.1, 1.5, 2.6), without=(2, 4, 5))
    partition += box((4, 2.4, 0), (4.1, 4, 2.6), without=(3, 4, 5))
    partition += box((4, 1.5, 2.1), (4.1, 2.4, 2.6), without=(2, 3, 5))
    return _lit([(box((0, 0, 0), (8.1, 4, 2.6), inward=True), WHITE), (partition, RED)], (1.5, 1.5), (2.5, 2.5))


def row_of_rooms(
    count: int, furnished: bool = True, lit: tuple[int, ...] | None = None, doorway: bool = True
) -> core.Environment:
    """Rooms of 5 x 4 x 2.6 m one behind the other, with doorways of 0.9 x 2.1 m in walls of 0.1 m between them.

    Each has a floor, a ceiling and walls of its own, and a lamp unless `lit` names the rooms that have one. Without
    doorways the walls are closed.
    """
    polygons, colors, lamps = [], [], []
    for room in range(count):
        first, last, start = room == 0, room == count - 1, np.array([5.1 * room, 0, 0])
        ends = tuple(side for side, there in ((0, first), (1, last)) if not there)
        parts = [(box((0, 0, 0), (5 if last else 5.1, 4, 2.6), inward=True, without=ends), WHITE)]
        if not last:
            low, high = (1.5, 2.4) if doorway else (2, 2)
            wall = box((5, 0, 0), (5.1, low, 2.6), without=(2, 4, 5)) + box(
                (5, high, 0), (5.1, 4, 2.6), without=(3, 4, 5)
            )
            if doorway:
                wall += box((5, low, 2.1), (5.1, high, 2.6), without=(2, 3, 5))
            parts.append((wall, RED))
        if furnished:
            parts.append((furniture(), WOOD))
        if lit is None or room in lit:
            parts.append((box((1.9, 1.6, 2.55), (2.7, 2.2, 2.58)), BLACK))
            lamps.append(len(polygons) + sum(len(part) for part, _ in parts) - 2)
        polygons += [polygon + start for part, _ in parts for polygon in part]
        colors += [color for part, color in parts for _ in part]
    emission = np.zeros((len(polygons), 3))
    emission[lamps] = LAMP
    return core.Environment.from_polygons(polygons, np.array(colors), emission)


def divided(environment: core.Environment, edge: float) -> core.Environment:
    """Surfaces halved into patches of about a square of side `edge`, in meters, or less."""
    size = UNITS * edge / float(np.ptp(environment.vertices, axis=0).max())
    limits = SubdivisionLimits(size, size / 4, size, size / 4, max_elements=2**20)
    hierarchy = Hierarchy.build(environment, limits)
    return hierarchy.polygons(hierarchy.patch_nodes)


def _lit(parts, low, high) -> core.Environment:
    """Polygons of one color a part, and a flat black box under the ceiling whose lower side glows."""
    lamp = box((*low, 2.55), (*high, 2.58))
    polygons = [polygon for part, _ in parts for polygon in part] + lamp
    colors = [color for part, color in parts for _ in part] + [BLACK] * len(lamp)
    emission = np.zeros((len(polygons), 3))
    emission[len(polygons) - 2] = LAMP
    return core.Environment.from_polygons(polygons, np.array(colors), emission)


SCENES: dict[str, Callable[[], core.Environment]] = {
    "cornell_box": cornell_box,
    "furnished_room": furnished_room,
    "two_rooms": two_rooms,
}
