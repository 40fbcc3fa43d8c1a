"""Emissive faces: which of them are lights of their own, and which are left to the hemispheres.

A small bright face must be aimed at: rays over the hemisphere would meet it by luck. A face that fills much of the
scene is met by many of them, and aiming would only add work. Both ways count every emitted watt once. Faces of a curved
surface that emits, a bulb of hundreds, are one light together.
"""

from __future__ import annotations

import numpy as np

from ..visibility.embree import OFFSET
from .area import AreaLight
from .emissive_groups import are_empty, connected_groups
from .mesh import MeshLight

#: Emitters of one look that cover more of all surfaces, or of the box around them if that is more, than this are left
#: to the hemispheres: every receiver then has dozens of its rays on them.
WIDE_SHARE = 0.4

#: Triangles of one look up to which the box counts. A glowing dome of thousands is left to the hemispheres, which meet
#: it, however large the box.
MAX_WIDE = 64

#: Emitters that give less than this part of all emitted power are left to the hemispheres too: their noise is small
#: against what lights the scene.
FAINT_SHARE = 1e-3

#: Corners of a quad lie this close to their mean plane, in unit lengths, for its two triangles to be one light.
FLATNESS = 0.1 * OFFSET

#: Connected triangles beyond which they are one mesh light: a few are exact and cheap as lights of their own.
MANY_TRIANGLES = 8

#: Radius of a mesh light, in unit lengths, above which it is divided: one visible share must stand for all of it.
LARGEST_RADIUS = 0.1


def area_lights(
    vertices: np.ndarray, triangles: np.ndarray, emission: np.ndarray, two_sided: np.ndarray, lamp_power: float
) -> tuple[list[AreaLight | MeshLight], np.ndarray]:
    """Lights made of emissive triangles, and which triangles those are: see `grouped_area_lights`."""
    alike = np.zeros(len(triangles), np.int64)
    lights, sampled, _ = grouped_area_lights(vertices, triangles, emission, two_sided, lamp_power, alike)
    return lights, sampled


def grouped_area_lights(
    vertices: np.ndarray,
    triangles: np.ndarray,
    emission: np.ndarray,
    two_sided: np.ndarray,
    lamp_power: float,
    light_groups: np.ndarray,
) -> tuple[list[AreaLight | MeshLight], np.ndarray, np.ndarray]:
    """Lights made of emissive triangles, none of triangles of two light groups.

    Parameters
    ----------
    vertices : (n, 3) float
    triangles : (m, 3) int
    emission : (m, 3) float
        Exitance in W/m2.
    two_sided : (m,) bool
    lamp_power : float
        Power in W of the other lights, brightest channel.
    light_groups : (m,) int

    Returns
    -------
    lights : list of AreaLight and MeshLight
        Pairs of triangles that make a convex planar quad become one light, and so do many triangles that hang together.
        The inside of a closed surface does not shine: what it emits stays there.
    sampled : (m,) bool
        Triangles whose emission these lights stand for.
    groups : (l,) int
        Light group of each light.
    """
    sampled = np.zeros(len(triangles), bool)
    emitting = np.nonzero(emission.max(axis=1) > 0)[0]
    nothing = [], sampled, np.empty(0, np.int64)
    if not len(emitting):
        return nothing
    corners = np.asarray(vertices, dtype=float)[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    total = areas.sum()
    # Two plates far from each other are all surfaces there are, and yet hardly a ray of one meets the other: compare
    # with the box around the scene as well, which no ray leaves unseen.
    sides = np.ptp(np.asarray(vertices, dtype=float)[triangles.ravel()], axis=0)
    around = 2 * (sides * np.roll(sides, 1)).sum()
    _, looks = np.unique(emission[emitting], axis=0, return_inverse=True)
    looks = looks.reshape(-1)
    power = areas[emitting] * emission[emitting].max(axis=1) * np.where(two_sided[emitting], 2, 1)
    cover, shine = np.bincount(looks, weights=areas[emitting]), np.bincount(looks, weights=power)
    few = np.bincount(looks) <= MAX_WIDE
    kept = (cover <= WIDE_SHARE * np.where(few, max(total, around), total)) & (
        shine >= FAINT_SHARE * (power.sum() + lamp_power)
    )
    chosen = emitting[kept[looks]]
    sampled[chosen] = True
    if not len(chosen):
        return nothing
    groups, closed = connected_groups(corners[chosen])
    foreign = np.ones(len(vertices), bool)
    foreign[triangles[chosen]] = False
    closed &= are_empty(corners[chosen], groups, np.asarray(vertices, dtype=float)[foreign])
    two_sided = two_sided.copy()
    two_sided[chosen[closed[groups]]] = False
    many = np.bincount(groups) > MANY_TRIANGLES
    few = chosen[~many[groups]]
    lights: list[AreaLight | MeshLight] = []
    members: list[int] = []
    for polygon, triangle in _polygons(corners, triangles, few, emission, two_sided, light_groups):
        lights.append(AreaLight(polygon, emission[triangle].astype(float), bool(two_sided[triangle])))
        members.append(int(light_groups[triangle]))
    order = np.argsort(groups, kind="stable")
    for group in np.flatnonzero(many):
        start, stop = np.searchsorted(groups[order], [group, group + 1])
        rows = chosen[order[start:stop]]
        for side in (False, True):
            for member in np.unique(light_groups[rows]):
                mine = rows[(two_sided[rows] == side) & (light_groups[rows] == member)]
                found = _mesh_lights(corners[mine], emission[mine].astype(float), side)
                lights += found
                members += [int(member)] * len(found)
    return lights, sampled, np.array(members, dtype=np.int64)


def _mesh_lights(corners: np.ndarray, emission: np.ndarray, two_sided: bool) -> list[MeshLight]:
    """Mesh lights of (t, 3, 3) triangles with emission (t, 3), small enough each.

    A light has one color. Where faces differ in more than brightness, a screen with a picture, there is one light per
    channel.
    """
    lights = []
    if not len(corners):
        return lights
    level = emission.max(axis=1)
    hues = emission / level[:, None]
    if np.ptp(hues, axis=0).max() < 1e-6:
        parts = [(hues[0], level)]
    else:
        parts = [(channel, emission @ channel) for channel in np.eye(3)]
    for color, intensities in parts:
        lit = intensities > 0
        if not lit.any():
            continue
        for piece in _small_pieces(corners[lit]):
            lights.append(MeshLight(corners[lit][piece], intensities[lit][piece], color, two_sided))
    return lights


def _small_pieces(corners: np.ndarray) -> list[np.ndarray]:
    """Rows of the triangles of each piece of `LARGEST_RADIUS` at most, or of few triangles."""
    middles = corners.mean(axis=1)
    pieces, left = [], [np.arange(len(corners))]
    while left:
        rows = left.pop()
        low, high = corners[rows].min(axis=(0, 1)), corners[rows].max(axis=(0, 1))
        if len(rows) <= MANY_TRIANGLES or np.linalg.norm(high - low) <= 2 * LARGEST_RADIUS:
            pieces.append(rows)
            continue
        rows = rows[np.argsort(middles[rows, (high - low).argmax()], kind="stable")]
        left += [rows[len(rows) // 2 :], rows[: len(rows) // 2]]
    return pieces


def _polygons(corners, triangles, chosen, emission, two_sided, light_groups):
    """Polygons of the chosen triangles, convex quads paired up, each with one of its triangles."""
    owner: dict[tuple[int, int], int] = {}
    for row in chosen:
        a, b, c = (int(x) for x in triangles[row])
        for edge in ((a, b), (b, c), (c, a)):
            owner[edge] = row
    used: set[int] = set()
    for row in chosen:
        if row in used:
            continue
        used.add(row)
        polygon = corners[row]
        indices = [int(x) for x in triangles[row]]
        for k in range(3):
            edge = (indices[k], indices[(k + 1) % 3])
            mate = owner.get((edge[1], edge[0]))
            if mate is None or mate in used:
                continue
            if not np.array_equal(emission[mate], emission[row]) or two_sided[mate] != two_sided[row]:
                continue
            if light_groups[mate] != light_groups[row]:
                continue
            far = next(int(x) for x in triangles[mate] if int(x) not in edge)
            point = corners[mate][[int(x) for x in triangles[mate]].index(far)]
            quad = np.insert(corners[row], k + 1, point, axis=0)
            if _is_flat_and_convex(quad):
                used.add(mate)
                polygon = quad
                break
        yield polygon, row


def _is_flat_and_convex(quad: np.ndarray) -> bool:
    sides = np.roll(quad, -1, axis=0) - quad
    turns = np.cross(sides, np.roll(sides, -1, axis=0))
    mean = turns.sum(axis=0)
    length = np.linalg.norm(mean)
    if length <= 0:
        return False
    # All corners turn the same way, and none leaves the mean plane by as much as receivers are lifted: those on a bent
    # face would lie behind its mean plane, and see all of its back.
    normal = mean / length
    heights = (quad - quad.mean(axis=0)) @ normal
    return bool((turns @ normal > 0).all() and (np.abs(heights) < FLATNESS).all())
