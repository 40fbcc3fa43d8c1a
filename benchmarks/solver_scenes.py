"""Lit scenes of polygons for the comparison of solvers: surfaces as given, which strategies divide."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
from radiosity import core

from .form_factor_scenes import REFERENCE_DATA, box, furniture

WHITE, WOOD, RED = (0.75, 0.75, 0.72), (0.5, 0.32, 0.18), (0.6, 0.25, 0.2)


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


def _lit(parts, low, high) -> core.Environment:
    """Polygons of one color a part, and a flat black box under the ceiling whose lower side glows."""
    lamp = box((*low, 2.55), (*high, 2.58))
    polygons = [polygon for part, _ in parts for polygon in part] + lamp
    colors = [color for part, color in parts for _ in part] + [(0.0, 0.0, 0.0)] * len(lamp)
    emission = np.zeros((len(polygons), 3))
    emission[len(polygons) - 2] = (12.0, 11.0, 9.0)  # of the box's sides the last but one is its lower
    return core.Environment.from_polygons(polygons, np.array(colors), emission)


SCENES: dict[str, Callable[[], core.Environment]] = {
    "cornell_box": cornell_box,
    "furnished_room": furnished_room,
    "two_rooms": two_rooms,
}
