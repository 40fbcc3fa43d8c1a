"""Faces in one another: pictures show one of them, whole, and nothing of what lies behind."""

import numpy as np
import pytest
from radiosity.core.rendering.coincident import told_apart
from radiosity.core.rendering.viewer import ShownScene, View, Viewer
from radiosity.core.visibility.embree import is_available

from tests.scenes import grid

FRONT, LABEL, INNER = (0.2, 0.2, 0.2), (0.6, 0.2, 0.1), (0.0, 0.0, 0.0)
#: A plane that no axis is aligned with, so that depths are rounded.
TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]


def square(half, divisions=1, flipped=False, away=0.0):
    corners = [(-half, -half, away), (half, -half, away), (half, half, away), (-half, half, away)]
    vertices, faces = grid(corners[::-1] if flipped else corners, divisions, divisions)
    triangles = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return np.asarray(vertices) @ TURN.T, triangles


def scene(*parts):
    vertices = np.concatenate([part[0][0] for part in parts])
    offsets = np.cumsum([0] + [len(part[0][0]) for part in parts])
    triangles = np.concatenate([part[0][1] + start for part, start in zip(parts, offsets[:-1], strict=True)])
    colors = np.concatenate([np.tile(np.float32(color), (len(part[1]), 3, 1)) for part, color in parts])
    return ShownScene(vertices, triangles, colors, np.ones(len(triangles), bool), np.ones(3))


def seen(shown, window=1.0):
    """Colors (r, 3) over a window of the plane, from somewhere aside before it."""
    right, _up, towards = TURN.T
    forward = -(towards + 0.3 * right)
    forward /= np.linalg.norm(forward)
    right = right - (right @ forward) * forward
    right /= np.linalg.norm(right)
    view = View(-5 * forward, right, np.cross(right, forward), forward, window, window, perspective=False)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.9, 0.9, 301), np.linspace(-0.9, 0.9, 301)))
    return Viewer(shown, 1).colors(view, x, y)[0]


@pytest.mark.skipif(not is_available(), reason="rays need embreex")
@pytest.mark.parametrize("divisions", [1, 3])
@pytest.mark.parametrize("order", [1, -1])
def test_the_smaller_of_two_faces_in_one_place_is_seen_whole(divisions, order):
    parts = [(square(1.2, 1), FRONT), (square(0.4, divisions), LABEL), (square(1.2, 2, flipped=True), INNER)]
    colors = seen(scene(*parts[::order]), 0.36)
    np.testing.assert_allclose(colors, np.tile(np.float32(LABEL), (len(colors), 1)), atol=1e-6)


@pytest.mark.skipif(not is_available(), reason="rays need embreex")
@pytest.mark.parametrize("order", [1, -1])
def test_the_side_turned_away_is_not_seen_through_the_one_turned_to_the_viewer(order):
    parts = [(square(1.2, 2), FRONT), (square(1.2, 5, flipped=True), INNER)]
    colors = seen(scene(*parts[::order]))
    np.testing.assert_allclose(colors, np.tile(np.float32(FRONT), (len(colors), 1)), atol=1e-6)


def test_surfaces_that_share_no_place_get_no_copies():
    # Neighbors in one plane that only touch, parallel ones, and a mesh in one piece.
    for parts in (
        [square(0.5, 4)],
        [square(0.5, 4), square(0.5, 4, away=0.01)],
        [square(0.5, 2), (square(0.5, 2)[0] + TURN[:, 0], square(0.5, 2)[1])],
    ):
        shown = scene(*((part, FRONT) for part in parts))
        vertices, triangles, source = told_apart(shown.vertices, shown.triangles)
        np.testing.assert_array_equal(triangles, shown.triangles)
        np.testing.assert_array_equal(source, np.arange(len(triangles)))
        assert len(vertices) == len(shown.vertices)


def test_copies_lie_before_their_faces_by_less_than_a_pixel():
    shown = scene((square(1.0), FRONT), (square(0.3), LABEL), (square(1.0, flipped=True), INNER))
    vertices, triangles, source = told_apart(shown.vertices, shown.triangles)
    assert sorted(source) == sorted([*range(6)] * 2)
    corners = shown.vertices[shown.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moved = np.einsum("tci,ti->tc", vertices[triangles[6:]] - corners[source[6:]], normals[source[6:]])
    assert (moved > 1e-6).all() and (moved < 1e-4).all()


def test_nothing_and_one_triangle():
    vertices, triangles, source = told_apart(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert not len(vertices) and not len(triangles) and not len(source)
    one = square(1.0)[0], square(1.0)[1][:1]
    assert told_apart(*one)[2].tolist() == [0]
