"""Error against time: points lie where their numbers say, and nothing is drawn that is not there."""

import numpy as np
import pytest
from radiosity.core.rendering.plot import _COLORS, Line, error_plot

SIZE = (600, 400)


def boxes(text):
    """Lettering of solid boxes: three fifths as wide as high."""
    left = np.arange(len(text)) * 0.6
    corners = np.stack([np.stack([left, 0 * left], 1), np.stack([left + 0.5, 0 * left], 1)], 1)
    top = corners[:, ::-1] + [0, 0.7]
    outline = np.concatenate([corners, top], axis=1)
    return np.stack([outline, np.roll(outline, -1, axis=1)], axis=2).reshape(-1, 2, 2), 0.6 * len(text)


def center(picture, color):
    """Mean (x, y) of the pixels of a color inside the axes."""
    hit = (np.abs(picture.astype(int) - np.round(255 * np.array(color))) <= 1).all(axis=2)
    rows, columns = np.nonzero(hit[:, : int(0.75 * SIZE[0])])
    return np.array([columns.mean(), rows.mean()]) + 0.5


def test_points_are_where_their_logarithms_are():
    # Three methods of one point each, in steps of a decade both ways: equal steps on the picture.
    lines = [Line(str(number), np.array([[10.0**number, 10.0**-number]])) for number in range(1, 4)]
    picture = error_plot(lines, 0.01, "", lambda text: (np.empty((0, 2, 2)), 0.0), SIZE)
    first, second, third = (center(picture, color) for color in _COLORS[:3])
    assert np.allclose(second - first, third - second, atol=0.6)
    assert (second - first)[0] > 50 and (second - first)[1] > 50


def test_the_accuracy_asked_for_is_a_line_at_its_height():
    ends = Line("a", np.array([[1.0, 0.1], [1.0, 0.001]]))
    picture = error_plot([ends], 0.013, "", boxes, SIZE)
    point = error_plot([ends, Line("b", np.array([[1.0, 0.013]]))], 0.05, "", boxes, SIZE)
    # Right of the line between the points, left of the words: there is grid, which is faint, and what is asked for.
    dark = (255 - picture[60:340, 330:380].astype(float)).mean(axis=(1, 2))
    rows = np.nonzero(dark > 0.7 * dark.max())[0]
    height = np.average(rows + 60.5, weights=dark[rows])
    assert abs(height - center(point, _COLORS[1])[1]) < 1


def test_the_recommended_has_a_ring():
    points = np.array([[1.0, 0.1], [4.0, 0.02]])
    plain = error_plot([Line("a", points)], 0.05, "", boxes, SIZE)
    marked = error_plot([Line("a", points, marked=1)], 0.05, "", boxes, SIZE)
    rows, columns = np.nonzero((plain != marked).any(axis=2)[:, : int(0.75 * SIZE[0])])
    dots = error_plot([Line("a", points[:1]), Line("b", points[1:])], 0.05, "", boxes, SIZE)
    expected = center(dots, _COLORS[1])
    assert np.allclose([columns.mean() + 0.5, rows.mean() + 0.5], expected, atol=1)


def test_a_refused_method_is_in_the_legend_only():
    points = np.array([[1.0, 0.1], [2.0, 0.05]])
    with_it = error_plot([Line("a", points), Line("refused", np.empty((0, 2)))], 0.05, "t", boxes, SIZE)
    without = error_plot([Line("a", points)], 0.05, "t", boxes, SIZE)
    changed = (with_it != without).any(axis=2)
    assert changed.any() and not changed[:, : int(0.76 * SIZE[0])].any()


@pytest.mark.parametrize("points", [[], [[0.0, 0.1]], [[1.0, np.nan]], [[1.0, -0.1]]])
def test_what_has_no_logarithm_is_refused(points):
    with pytest.raises(ValueError, match="above 0"):
        error_plot([Line("a", np.array(points).reshape(-1, 2))], 0.05, "", boxes, SIZE)
