"""Emissive faces: which of them are lights of their own, and which are left to the hemispheres.

A small bright face must be aimed at: rays over the hemisphere would meet it by luck. A face that fills much of the
scene is met by many of them, and aiming would only add work. Both ways count every emitted watt once.
"""

from __future__ import annotations

import numpy as np

from ..visibility.embree import OFFSET
from .area import AreaLight

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


def area_lights(
    vertices: np.ndarray, triangles: np.ndarray, emission: np.ndarray, two_sided: np.ndarray, lamp_power: float
) -> tuple[list[AreaLight], np.ndarray]:
    """Lights made of emissive triangles.

    Parameters
    ----------
    vertices : (n, 3) float
    triangles : (m, 3) int
    emission : (m, 3) float
        Exitance in W/m2.
    two_sided : (m,) bool
    lamp_power : float
        Power in W of the other lights, brightest channel.

    Returns
    -------
    lights : list of AreaLight
        Pairs of triangles that make a convex planar quad become one light.
    sampled : (m,) bool
        Triangles whose emission these lights stand for.
    """
    sampled = np.zeros(len(triangles), bool)
    emitting = np.nonzero(emission.max(axis=1) > 0)[0]
    if not len(emitting):
        return [], sampled
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
    lights = []
    for polygon, triangle in _polygons(corners, triangles, chosen, emission, two_sided):
        lights.append(AreaLight(polygon, emission[triangle].astype(float), bool(two_sided[triangle])))
    return lights, sampled


def _polygons(corners, triangles, chosen, emission, two_sided):
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
