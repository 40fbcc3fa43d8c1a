"""Error against time, one line a method: both axes logarithmic, the accuracy asked for as a dashed line.

Nothing but NumPy draws it, so that it is the same in Blender as anywhere. Letters come from whoever has a font.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor, log10

import numpy as np

from .canvas import Canvas

#: Gives a text one unit high as directed edges (m, 2, 2), y upward from its base line, and how long it is.
Lettering = Callable[[str], tuple[np.ndarray, float]]

#: Colors told apart by most eyes, color-blind ones included (Okabe and Ito 2008, "Color Universal Design"), without
#: their yellow, which is lost on white, and with a gray and a brown in its place.
_COLORS = (
    (0.0, 0.0, 0.0), (0.90, 0.62, 0.0), (0.34, 0.71, 0.91), (0.0, 0.62, 0.45), (0.0, 0.45, 0.70),
    (0.84, 0.37, 0.0), (0.80, 0.47, 0.65), (0.55, 0.55, 0.55), (0.45, 0.27, 0.13),
)  # fmt: skip

_INK, _GRID, _FAINT = (0.15, 0.15, 0.15), (0.88, 0.88, 0.88), (0.45, 0.45, 0.45)


@dataclass(frozen=True)
class Line:
    """One method: its name and points (n, 2) of seconds and error, both above 0; `marked` is the one recommended."""

    name: str
    points: np.ndarray
    marked: int | None = None


def error_plot(
    lines: Sequence[Line],
    asked: float,
    title: str,
    lettering: Lettering,
    size: tuple[int, int] = (1200, 800),
    labels: tuple[str, str] = ("seconds", "error (relative RMS)"),
) -> np.ndarray:
    """Picture (h, w, 3) uint8 of error against time.

    Parameters
    ----------
    lines : sequence of Line
        Those without points appear in the legend, faint.
    asked : float
        Accuracy asked for.
    title : str
    lettering : Lettering
    size : (width, height) in pixels
    labels : names of the two axes

    Raises
    ------
    ValueError
        If no line has a point, or one is not above 0 and finite.
    """
    points = np.concatenate(
        [np.asarray(line.points, dtype=float).reshape(-1, 2) for line in lines] or [np.empty((0, 2))]
    )
    if not len(points) or not (np.isfinite(points).all() and (points > 0).all()):
        raise ValueError("a plot needs points above 0")
    plot = _Axes(points, asked, size, lettering)
    plot.draw_grid(title, labels)
    for number, line in enumerate(lines):
        plot.draw_line(line, _COLORS[number % len(_COLORS)], number // len(_COLORS))
    plot.draw_legend(lines)
    return plot.canvas.pixels


class _Axes:
    """Where seconds and errors lie on the canvas, and what is drawn there."""

    def __init__(self, points: np.ndarray, asked: float, size: tuple[int, int], lettering: Lettering) -> None:
        width, height = size
        self.canvas, self.lettering, self.asked = Canvas(width, height), lettering, asked
        self.unit = height / 800  # what is drawn keeps its share of the picture
        self.left, self.right = 0.09 * width, 0.76 * width
        self.top, self.bottom = 0.1 * height, 0.89 * height
        self.low = np.log10([points[:, 0].min(), min(points[:, 1].min(), asked)])
        self.high = np.log10([points[:, 0].max(), max(points[:, 1].max(), asked)])
        # A tenth of a decade of air, and half a decade at least to see anything in.
        air = np.maximum(0.5 - (self.high - self.low), 0) / 2 + 0.1
        self.low, self.high = self.low - air, self.high + air

    def place(self, points: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) of points (n, 2)."""
        share = (np.log10(points) - self.low) / (self.high - self.low)
        corner, far = np.array([self.left, self.bottom]), np.array([self.right, self.top])
        return corner + share * (far - corner)

    def text(self, text: str, x: float, y: float, height: float, align: float = 0.0, color=_INK, upright=False) -> None:
        """Letters `height` pixels high from a base line through (x, y); `align` of their length lies left of x."""
        edges, length = self.lettering(text)
        scaled = (edges - [align * length, 0]) * [height, -height]
        if upright:
            scaled = scaled[..., ::-1] * [1, -1]
        self.canvas.fill(scaled + np.array([x, y]), color)

    def draw_grid(self, title: str, labels: tuple[str, str]) -> None:
        """Grid, ticks, what is asked for, and names."""
        unit = self.unit
        for axis in range(2):
            for tick in _ticks(self.low[axis], self.high[axis]):
                x, y = self.place(np.array([[tick, tick]]))[0]
                if axis == 0:
                    self.canvas.line((x, self.top), (x, self.bottom), unit, _GRID)
                    self.text(f"{tick:g}", x, self.bottom + 26 * unit, 18 * unit, 0.5)
                else:
                    self.canvas.line((self.left, y), (self.right, y), unit, _GRID)
                    self.text(f"{100 * tick:g} %", self.left - 8 * unit, y + 6 * unit, 18 * unit, 1.0)
        frame = [(self.left, self.top), (self.left, self.bottom), (self.right, self.bottom), (self.right, self.top)]
        for start, end in zip(frame, frame[1:] + frame[:1], strict=True):
            self.canvas.line(start, end, 1.5 * unit, _FAINT)
        y = self.place(np.array([[1.0, self.asked]]))[0, 1]
        dash = 12 * unit
        for x in np.arange(self.left, self.right - dash / 2, 2 * dash):
            self.canvas.line((x, y), (min(x + dash, self.right), y), 2 * unit, _FAINT)
        self.text(f"asked {100 * self.asked:g} %", self.right - 6 * unit, y - 7 * unit, 17 * unit, 1.0, _FAINT)
        self.text(title, self.left, self.top - 24 * unit, 25 * unit)
        middle, centre = (self.left + self.right) / 2, (self.top + self.bottom) / 2
        self.text(labels[0], middle, self.bottom + 62 * unit, 21 * unit, 0.5)
        self.text(labels[1], self.left - 78 * unit, centre, 21 * unit, 0.5, upright=True)

    def draw_line(self, line: Line, color, turn: int) -> None:
        """A line through its points, each a dot; square where the color has been used before."""
        if not len(line.points):
            return
        places = self.place(np.asarray(line.points, dtype=float))
        for start, end in pairwise(places):
            self.canvas.line(start, end, 2.5 * self.unit, color, 0.8)
        for number, place in enumerate(places):
            if number == line.marked:
                self.canvas.polygon(_round(place, 15 * self.unit, 48), _INK)
                self.canvas.polygon(_round(place, 12 * self.unit, 48), (1, 1, 1))
            self.canvas.polygon(_round(place, 7 * self.unit, 4 if turn else 32), color)

    def draw_legend(self, lines: Sequence[Line]) -> None:
        """Names of the lines, those without points faint; below them what the ring means."""
        unit, x, y = self.unit, self.right + 28 * self.unit, self.top + 14 * self.unit
        for number, line in enumerate(lines):
            has_points, row = len(line.points) > 0, y + 30 * unit * number
            color = _COLORS[number % len(_COLORS)] if has_points else _GRID
            corners = 4 if number >= len(_COLORS) else 32
            self.canvas.polygon(_round((x, row - 6 * unit), 7 * unit, corners), color)
            self.text(line.name, x + 18 * unit, row, 19 * unit, 0.0, _INK if has_points else _FAINT)
        if any(line.marked is not None for line in lines):
            row = y + 30 * unit * (len(lines) + 0.6)
            self.canvas.polygon(_round((x, row - 6 * unit), 10 * unit, 48), _INK)
            self.canvas.polygon(_round((x, row - 6 * unit), 8 * unit, 48), (1, 1, 1))
            self.text("recommended", x + 18 * unit, row, 19 * unit)


def _round(center, radius: float, corners: int) -> np.ndarray:
    angles = np.pi / 4 + 2 * np.pi * np.arange(corners) / corners
    return np.asarray(center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of each decade between two exponents of ten; only 1 where that would be a crowd."""
    leads = (1, 2, 5) if high - low < 3.5 else (1,)
    decades = range(floor(low), ceil(high) + 1)
    return [lead * 10.0**decade for decade in decades for lead in leads if low <= log10(lead) + decade <= high]
