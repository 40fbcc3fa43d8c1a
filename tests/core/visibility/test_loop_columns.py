"""Convex loops as columns: what splitting leaves has the whole area, on the right sides."""

import numpy as np
from radiosity.core.visibility.loop_columns import LoopColumns, concatenate, split


def loops(count, corners, spare, seed=0):
    """Convex loops of `corners` corners, and `spare` copies of the last, in random planes."""
    generator = np.random.default_rng(seed)
    angles = np.sort(generator.random((corners, count)) * 2 * np.pi, axis=0)
    axes = np.linalg.qr(generator.normal(size=(count, 3, 3)))[0]
    flat = np.stack((np.cos(angles), np.sin(angles)))
    places = np.einsum("akm,mai->ikm", flat, axes[:, :2]) + generator.normal(size=(3, 1, count))
    return LoopColumns(np.concatenate([places] + [places[:, -1:]] * spare, axis=1), np.full(count, corners))


def areas(columns):
    corners = columns.corners.transpose(2, 1, 0)
    arms = corners - corners[:, :1]
    return np.linalg.norm(np.cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1), axis=1) / 2


def test_parts_make_the_whole_and_lie_on_their_sides():
    generator = np.random.default_rng(1)
    for corners, spare in ((3, 0), (4, 0), (4, 3), (7, 1)):
        whole = loops(500, corners, spare)
        planes = generator.normal(size=(3, 500))
        above, up, below, down = split(whole, whole.heights(planes), 1e-12)
        total = np.bincount(up, areas(above), 500) + np.bincount(down, areas(below), 500)
        np.testing.assert_allclose(total, areas(whole), rtol=0, atol=1e-13)
        assert above.heights(planes[:, up]).min() >= -1e-12 and below.heights(planes[:, down]).max() <= 1e-12
        both = np.intersect1d(up, down)
        assert len(both) > 50 and (above.sizes[np.isin(up, both)] >= 3).all()
        # Copies of the last corner do not add up over splits.
        assert max(above.sizes.max(), below.sizes.max()) <= corners + 1


def test_a_plane_through_corners_cuts_between_them_and_one_along_an_edge_does_not():
    square = np.array([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]).T[:, :, None]
    columns = concatenate([LoopColumns(square, np.array([4]))] * 3)
    planes = np.array([[1.0, 1, 0], [1, 0, 1], [0, 0, 0.0]]).T
    above, up, below, down = split(columns, columns.heights(planes), 1e-12)
    np.testing.assert_array_equal(up, [0, 1])
    np.testing.assert_array_equal(down, [0])
    np.testing.assert_allclose(areas(above), [2, 4])
    np.testing.assert_allclose(areas(below), [2])
    assert above.sizes[0] == 3
