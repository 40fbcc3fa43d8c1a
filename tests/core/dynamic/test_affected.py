"""Hulls against boxes: the exact test agrees with dense sampling, on the safe side."""

import numpy as np
from radiosity.core.dynamic.affected import hull_meets


def test_hulls_agree_with_dense_sampling():
    random = np.random.default_rng(3)
    points, middles = random.uniform(-1, 1, (2, 500, 3))
    half = random.uniform(0, 0.2, (500, 3))
    boxes = np.array([[[-0.4, -0.1, -0.2], [-0.1, 0.3, 0.1]], [[0.3, 0.3, 0.3], [0.5, 0.4, 0.6]]])
    met = hull_meets(points, middles - half, middles + half, boxes)
    steps = np.linspace(0, 1, 400)[None, :, None]
    along = points[:, None] + steps * (middles - points)[:, None]
    # A box of the sweep meets a box where their middles are no farther apart than their half sides add up to.
    sampled = np.zeros(500, bool)
    for low, high in boxes:
        apart = np.abs(along - (low + high) / 2) - steps * half[:, None]
        sampled |= (apart <= (high - low) / 2).all(axis=2).any(axis=1)
    assert met[sampled].all()
    # Both answers are common. Steps of 1/400 of at most 3.5 miss hulls that cut less than 0.01 off a corner: 1 %.
    assert 50 < sampled.sum() < 450
    assert (met & ~sampled).sum() <= 5


def test_segments_along_an_axis_and_beside_a_box():
    box = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]])
    points = np.array([[0.5, 0.5, 2.0], [1.5, 0.5, 2.0], [0.5, 0.5, 3.0], [0.5, 0.5, 0.5]])
    ends = np.array([[0.5, 0.5, -1.0], [1.5, 0.5, -1.0], [0.5, 0.5, 1.5], [0.5, 0.5, 0.5]])
    assert hull_meets(points, ends, ends, box).tolist() == [True, False, False, True]
    assert not hull_meets(points, ends, ends, box[:0]).any()
