"""Arithmetic of colors in shader nodes: color models, blend modes and adjustments, elementwise on arrays.

The formulas are those of Blender's color nodes, so that a material reads as it renders. Colors are (n, 3) and factors
(n, 1); either may have one row for a constant.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """(n, 3) hue, saturation and value, hue from 0 to 1."""
    high, low = rgb.max(1), rgb.min(1)
    spread = high - low
    safe = np.where(spread == 0, 1, spread)
    red, green, blue = rgb.T
    hue = np.select(
        [spread == 0, high == red, high == green],
        [0, ((green - blue) / safe) % 6, (blue - red) / safe + 2],
        (red - green) / safe + 4,
    )
    return np.stack([hue / 6, np.where(high == 0, 0, spread / np.where(high == 0, 1, high)), high], axis=1)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    """Inverse of `rgb_to_hsv`."""
    hue, saturation, value = hsv.T
    ramp = np.abs((hue[:, None] * 6 + np.array([0, 4, 2])) % 6 - 3) - 1
    return value[:, None] * (1 + saturation[:, None] * (np.clip(ramp, 0, 1) - 1))


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    """(n, 3) hue, saturation and lightness."""
    high, low = rgb.max(1), rgb.min(1)
    lightness = (high + low) / 2
    room = 1 - np.abs(2 * lightness - 1)
    saturation = np.where(room == 0, 0, (high - low) / np.where(room == 0, 1, room))
    return np.stack([rgb_to_hsv(rgb)[:, 0], saturation, lightness], axis=1)


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    """Inverse of `rgb_to_hsl`."""
    hue, saturation, lightness = hsl.T
    chroma = (1 - np.abs(2 * lightness - 1)) * saturation
    pure = hsv_to_rgb(np.stack([hue, np.ones_like(hue), np.ones_like(hue)], axis=1))
    return (pure - 0.5) * chroma[:, None] + lightness[:, None]


def _over(numerator: np.ndarray, denominator: np.ndarray, otherwise) -> np.ndarray:
    """Quotient, and `otherwise` where the denominator is zero."""
    return np.where(denominator == 0, otherwise, numerator / np.where(denominator == 0, 1, denominator))


def _lerp(a, b, t):
    return a + (b - a) * t


def _overlay(a, b, t):
    return np.where(a < 0.5, a * (1 - t + 2 * t * b), 1 - (1 - t + 2 * t * (1 - b)) * (1 - a))


def _burn(a, b, t):
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0, np.clip(1 - _over(1 - a, rest, 0), 0, 1))


def _dodge(a, b, t):
    rest = 1 - t * b
    return np.where(a == 0, 0, np.where(rest <= 0, 1, np.minimum(_over(a, rest, 1), 1)))


def _soft_light(a, b, t):
    screen = 1 - (1 - b) * (1 - a)
    return (1 - t) * a + t * ((1 - a) * b * a + a * screen)


def _through_hsv(change: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]):
    """A blend mode that works on hue, saturation and value."""

    def blend(a, b, t):
        a, b, t = np.broadcast_arrays(a, b, t)
        return change(a, b, t)

    return blend


def _hue(a, b, t):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    tinted = hsv_to_rgb(np.stack([other[:, 0], hsv[:, 1], hsv[:, 2]], axis=1))
    return np.where(other[:, 1:2] == 0, a, _lerp(a, tinted, t))


def _saturation(a, b, t):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    mixed = hsv_to_rgb(np.stack([hsv[:, 0], _lerp(hsv[:, 1], other[:, 1], t[:, 0]), hsv[:, 2]], axis=1))
    return np.where(hsv[:, 1:2] == 0, a, mixed)


def _color(a, b, t):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    tinted = hsv_to_rgb(np.stack([other[:, 0], other[:, 1], hsv[:, 2]], axis=1))
    return np.where(other[:, 1:2] == 0, a, _lerp(a, tinted, t))


def _value(a, b, t):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    return hsv_to_rgb(np.stack([hsv[:, 0], hsv[:, 1], _lerp(hsv[:, 2], other[:, 2], t[:, 0])], axis=1))


#: By Blender's name: (color under, color over, factor) to color.
BLEND_MODES = {
    'MIX': _lerp,
    'DARKEN': lambda a, b, t: _lerp(a, np.minimum(a, b), t),
    'MULTIPLY': lambda a, b, t: _lerp(a, a * b, t),
    'BURN': _burn,
    'LIGHTEN': lambda a, b, t: _lerp(a, np.maximum(a, b), t),
    'SCREEN': lambda a, b, t: 1 - (1 - t + t * (1 - b)) * (1 - a),
    'DODGE': _dodge,
    'ADD': lambda a, b, t: a + b * t,
    'OVERLAY': _overlay,
    'SOFT_LIGHT': _soft_light,
    'LINEAR_LIGHT': lambda a, b, t: a + t * (2 * b - 1),
    'DIFFERENCE': lambda a, b, t: _lerp(a, np.abs(a - b), t),
    'EXCLUSION': lambda a, b, t: np.maximum(_lerp(a, a + b - 2 * a * b, t), 0),
    'SUBTRACT': lambda a, b, t: a - b * t,
    'DIVIDE': lambda a, b, t: np.where(b == 0, a, (1 - t) * a + t * _over(a, b, 0)),
    'HUE': _through_hsv(_hue),
    'SATURATION': _through_hsv(_saturation),
    'COLOR': _through_hsv(_color),
    'VALUE': _through_hsv(_value),
}


def adjust_hsv(hue, saturation, value, factor, color):
    """The Hue/Saturation/Value node."""
    hue, saturation, value, factor, color = np.broadcast_arrays(hue, saturation, value, factor, color)
    hsv = rgb_to_hsv(color)
    shifted = np.stack(
        [(hsv[:, 0] + hue[:, 0] + 0.5) % 1, np.clip(hsv[:, 1] * saturation[:, 0], 0, 1), hsv[:, 2] * value[:, 0]],
        axis=1,
    )
    return np.maximum(_lerp(color, hsv_to_rgb(shifted), factor), 0)


def adjust_contrast(color, brightness, contrast):
    """The Brightness/Contrast node."""
    return np.maximum((1 + contrast) * color + brightness - contrast * 0.5, 0)


def adjust_gamma(color, gamma):
    """The Gamma node: negative channels stay as they are."""
    return np.where(color > 0, np.where(color > 0, color, 1) ** gamma, color)


def invert(factor, color):
    """The Invert node."""
    return _lerp(color, 1 - color, factor)
