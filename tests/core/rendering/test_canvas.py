"""Filled shapes on a canvas: their area, holes, order of edges, and what lies outside."""

import numpy as np
import pytest
from radiosity.core.rendering.canvas import Canvas

BLACK = (0.0, 0.0, 0.0)


def ink(canvas):
    """Share of black of each pixel."""
    return 1 - canvas.pixels[..., 0] / 255


def edges(*outlines):
    return np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in map(np.asarray, outlines)]).astype(
        float
    )


def square(low, high):
    return [(low, low), (high, low), (high, high), (low, high)]


def test_whole_pixels_are_filled_exactly():
    canvas = Canvas(8, 6)
    canvas.polygon([(2, 1), (5, 1), (5, 4), (2, 4)], BLACK)
    expected = np.zeros((6, 8))
    expected[1:4, 2:5] = 1
    assert np.array_equal(ink(canvas), expected)


@pytest.mark.parametrize("turn", [1, -1])
def test_area_is_that_of_the_shape_whichever_way_around(turn):
    canvas = Canvas(60, 50)
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)[::turn]
    canvas.polygon(np.stack([30.3 + 18 * np.cos(angles), 24.7 + 18 * np.sin(angles)], axis=1), BLACK)
    # A sample is right or wrong only next to the outline: 4 samples a pixel side, half of one along the circumference.
    assert abs(ink(canvas).sum() - np.pi * 18**2) < 2 * np.pi * 18 / 4 / 2


def test_an_outline_the_other_way_is_a_hole_and_one_the_same_way_is_not():
    hole, whole = Canvas(20, 20), Canvas(20, 20)
    hole.fill(edges(square(2, 18), square(6, 12)[::-1]), BLACK)
    whole.fill(edges(square(2, 18), square(6, 12)), BLACK)
    assert ink(hole).sum() == 16**2 - 6**2
    assert ink(whole).sum() == 16**2


def test_what_lies_outside_is_cut_off():
    canvas = Canvas(10, 10)
    canvas.polygon(square(-5, 3), BLACK)
    canvas.polygon(square(8, 400), BLACK)
    canvas.polygon(square(20, 30), BLACK)
    canvas.polygon([(-30, 4), (-20, 4), (-20, 6)], BLACK)
    assert ink(canvas).sum() == 3**2 + 2**2


def test_colors_mix_by_opacity_and_lines_have_their_width():
    canvas = Canvas(10, 10, background=(1, 1, 1))
    canvas.line((1, 5), (9, 5), 2, (1, 0, 0), opacity=0.5)
    assert np.array_equal(canvas.pixels[4:6, 1:9], np.broadcast_to([255, 128, 128], (2, 8, 3)))
    assert (canvas.pixels != 255).any(axis=2).sum() == 16


def test_nothing_to_fill_changes_nothing():
    canvas = Canvas(4, 4)
    canvas.fill(np.empty((0, 2, 2)), BLACK)
    canvas.line((1, 1), (1, 1), 2, BLACK)
    canvas.polygon([(1, 1), (3, 1)], BLACK)
    assert (canvas.pixels == 255).all()
