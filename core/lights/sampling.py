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


#: Scouts between the middle and the rim of a polygon: this part of the way to it, at this part of each of its sides.
#: Off its axes, or the cross of a window's bars would hide them all.
WAY, TURN = 0.6, 0.3


def polygon_scouts(vertices: np.ndarray, within: int = 0) -> np.ndarray:
    """(s, 3) the middle of a convex polygon (k, 3), its corners, four of them where it has more, a place between each
    of them and the middle, and `within` places spread over it."""
    middle = vertices.mean(axis=0)
    corners = vertices if len(vertices) <= 4 else vertices[(np.arange(4) * len(vertices)) // 4]
    arms = corners - middle
    turned = (1 - TURN) * arms + TURN * np.roll(arms, -1, axis=0)
    places = np.concatenate([middle[None], middle + RIM * arms, middle + WAY * turned])
    return np.concatenate([places, polygon(vertices, within)]) if within else places


def near_rectangle(
    corner: np.ndarray, sides: np.ndarray, points: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, count, 3) on a rectangle, denser where each of n points (n, 3) is near, and the area (n, count) that
    each place stands for, in shares of the rectangle times `count`.

    The first coordinate is spread as 1 / (h^2 + x^2) around the point's foot, h being its height, and the second as
    1 / (d^2 + y^2), d being the distance to the line chosen: their angles are uniform as the point sees them. Against
    light that falls as cos(receiver) cos(light) / r^2 no place weighs more than a few times the mean, however near the
    point and whichever way it faces. From far away the places are those of `square`.

    Parameters
    ----------
    corner : (3,) float
        Of the rectangle.
    sides : (2, 3) float
        Its two sides, perpendicular to each other.
    points : (n, 3) float
    count : int
    """
    lengths = np.linalg.norm(sides, axis=1)
    away = points - corner
    axes = sides / lengths[:, None]
    foot = away @ axes.T
    normal = np.cross(*axes)
    # A point in the plane itself sees nothing of it; the floor only keeps the arithmetic finite.
    height = np.maximum(np.abs(away @ normal), 1e-9 * lengths.max())[:, None]
    spread = square(count)
    x, x_part = _by_angle(foot[:, :1], lengths[0], height, spread[:, 0])
    y, y_part = _by_angle(foot[:, 1:], lengths[1], np.hypot(height, x - foot[:, :1]), spread[:, 1])
    return corner + np.stack([x, y], axis=2) @ axes, x_part * y_part


def _by_angle(foot, length, distance, spread) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, c) along a line of a `length`, uniform in the angle in which a point sees them whose `foot` (n, 1) is
    the nearest place and whose `distance` (n, 1 or c) is that to it; and the part of the line each stands for, times c.
    """
    low, high = np.arctan(-foot / distance), np.arctan((length - foot) / distance)
    tangent = np.tan(low + spread * (high - low))
    part = distance * (high - low) * (1 + tangent**2) / length
    return np.clip(foot + distance * tangent, 0, length), part


def facing_disks(directions: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """(n, count, 3) the places `pattern` (count, 2) of disks around the origin facing unit `directions` (n, 3)."""
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(directions, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, directions)
    return pattern[:, 0, None] * across[:, None] + pattern[:, 1, None] * up[:, None]
