"""Well-spread points on a square, a disk and a polygon: deterministic, equal at every call.

The same points serve all receivers. Visibility then changes smoothly from one vertex to the next, where points chosen
per vertex would turn the sampling error into speckles.
"""

from __future__ import annotations

import numpy as np

#: Fractional parts that spread best in two dimensions: powers of the inverse of the plastic number (Roberts 2018, "The
#: Unreasonable Effectiveness of Quasirandom Sequences").
PLASTIC = 1.32471795724474602596


def square(count: int) -> np.ndarray:
    """(count, 2) low-discrepancy points in [0, 1)."""
    if count == 1:
        return np.full((1, 2), 0.5)
    index = np.arange(count)
    return np.column_stack([(index + 0.5) / count, (0.5 + (index + 1) / PLASTIC) % 1.0])


def disk(count: int) -> np.ndarray:
    """(count, 2) points in the unit disk with equal area each: a sunflower spiral (Vogel 1979)."""
    if count == 1:
        return np.zeros((1, 2))
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    angle = index * np.pi * (3 - np.sqrt(5))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def polygon(vertices: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) points, uniform over a convex planar polygon (k, 3)."""
    if len(vertices) == 4 and np.allclose(vertices[0] + vertices[2], vertices[1] + vertices[3], rtol=0, atol=1e-9):
        s = square(count)
        return vertices[0] + s[:, :1] * (vertices[1] - vertices[0]) + s[:, 1:] * (vertices[3] - vertices[0])
    fan = np.stack([np.broadcast_to(vertices[0], (len(vertices) - 2, 3)), vertices[1:-1], vertices[2:]], axis=1)
    areas = np.linalg.norm(np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]), axis=1)
    share = np.cumsum(areas) / areas.sum()
    points = square(count)
    # The first coordinate picks the triangle of the fan and what is left of it serves again within.
    which = np.minimum(np.searchsorted(share, points[:, 0], side="right"), len(fan) - 1)
    start = np.concatenate([[0.0], share[:-1]])[which]
    left = np.clip((points[:, 0] - start) / np.maximum(share[which] - start, 1e-300), 0, 1)
    return on_triangles(fan[which], np.column_stack([left, points[:, 1]]))


def on_triangles(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) places on n triangles (n, 3, 3), uniform where the points (n, 2) are in the unit square."""
    root = np.sqrt(points[:, 0])
    weights = np.column_stack([1 - root, root * (1 - points[:, 1]), root * points[:, 1]])
    return np.einsum("nk,nki->ni", weights, triangles)


#: Part of the way from the middle to the rim at which scouts look: on the rim itself they would graze the lamp's frame.
RIM = 0.98


def disk_scouts() -> np.ndarray:
    """(5, 2) the middle of the unit disk and four places on its rim."""
    return np.array([[0, 0], [RIM, 0], [0, RIM], [-RIM, 0], [0, -RIM]])


def polygon_scouts(vertices: np.ndarray, within: int = 0) -> np.ndarray:
    """(s, 3) the middle of a convex polygon (k, 3) and its corners, four of them where it has more, and `within` places
    spread over it."""
    middle = vertices.mean(axis=0)
    corners = vertices if len(vertices) <= 4 else vertices[(np.arange(4) * len(vertices)) // 4]
    places = np.concatenate([middle[None], middle + RIM * (corners - middle)])
    return np.concatenate([places, polygon(vertices, within)]) if within else places


def facing_disks(directions: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """(n, count, 3) the places `pattern` (count, 2) of disks around the origin facing unit `directions` (n, 3)."""
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(directions, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, directions)
    return pattern[:, 0, None] * across[:, None] + pattern[:, 1, None] * up[:, None]
