"""Arithmetic of shader nodes: Math, Vector Math, Map Range, Clamp, ramps and curves.

Operations take (n, 1) values or (n, 3) vectors. As in Blender, what is undefined (division by zero, the root of a
negative number) gives zero and never a NaN.
"""

from __future__ import annotations

from math import pi

import numpy as np

#: Samples of a ramp or curve between 0 and 1; Cycles itself takes 256.
TABLE_SIZE = 1025


def _divide(a, b):
    return np.where(b == 0, 0, a / np.where(b == 0, 1, b))


def _power(a, b):
    with np.errstate(all="ignore"):
        result = np.power(a, b)
    return np.where(np.isfinite(result), result, 0)


def _logarithm(a, b):
    usable = (a > 0) & (b > 0) & (b != 1)
    return np.where(usable, np.log(np.where(usable, a, 1)) / np.log(np.where(usable, b, 2)), 0)


def _wrap(value, high, low):
    extent = high - low
    return np.where(extent == 0, low, value - extent * np.floor(_divide(value - low, extent)))


def _ping_pong(value, scale):
    folded = np.abs(_divide(value - scale, scale * 2) % 1 * scale * 2 - scale)
    return np.where(scale == 0, 0, folded)


def _smooth_min(a, b, distance):
    overlap = np.maximum(distance - np.abs(a - b), 0)
    bend = _divide(overlap, distance)
    return np.minimum(a, b) - bend**3 * distance / 6


#: By Blender's name: a function of three (n, 1) values; operations of fewer ignore the rest.
MATH = {
    'ADD': lambda a, b, c: a + b,
    'SUBTRACT': lambda a, b, c: a - b,
    'MULTIPLY': lambda a, b, c: a * b,
    'DIVIDE': lambda a, b, c: _divide(a, b),
    'MULTIPLY_ADD': lambda a, b, c: a * b + c,
    'POWER': lambda a, b, c: _power(a, b),
    'LOGARITHM': lambda a, b, c: _logarithm(a, b),
    'SQRT': lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    'INVERSE_SQRT': lambda a, b, c: _divide(np.ones_like(a), np.sqrt(np.maximum(a, 0))),
    'ABSOLUTE': lambda a, b, c: np.abs(a),
    'EXPONENT': lambda a, b, c: np.exp(a),
    'MINIMUM': lambda a, b, c: np.minimum(a, b),
    'MAXIMUM': lambda a, b, c: np.maximum(a, b),
    'LESS_THAN': lambda a, b, c: 1.0 * (a < b),
    'GREATER_THAN': lambda a, b, c: 1.0 * (a > b),
    'SIGN': lambda a, b, c: np.sign(a),
    'COMPARE': lambda a, b, c: 1.0 * (np.abs(a - b) <= np.maximum(c, 1e-5)),
    'SMOOTH_MIN': lambda a, b, c: _smooth_min(a, b, np.maximum(c, 0)),
    'SMOOTH_MAX': lambda a, b, c: -_smooth_min(-a, -b, np.maximum(c, 0)),
    'ROUND': lambda a, b, c: np.floor(a + 0.5),
    'FLOOR': lambda a, b, c: np.floor(a),
    'CEIL': lambda a, b, c: np.ceil(a),
    'TRUNC': lambda a, b, c: np.trunc(a),
    'FRACT': lambda a, b, c: a - np.floor(a),
    'MODULO': lambda a, b, c: np.where(b == 0, 0, np.fmod(a, np.where(b == 0, 1, b))),
    'FLOORED_MODULO': lambda a, b, c: np.where(b == 0, 0, np.mod(a, np.where(b == 0, 1, b))),
    'WRAP': _wrap,
    'SNAP': lambda a, b, c: np.floor(_divide(a, b)) * b,
    'PINGPONG': lambda a, b, c: _ping_pong(a, b),
    'SINE': lambda a, b, c: np.sin(a),
    'COSINE': lambda a, b, c: np.cos(a),
    'TANGENT': lambda a, b, c: np.tan(a),
    'ARCSINE': lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    'ARCCOSINE': lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    'ARCTANGENT': lambda a, b, c: np.arctan(a),
    'ARCTAN2': lambda a, b, c: np.arctan2(a, b),
    'SINH': lambda a, b, c: np.sinh(a),
    'COSH': lambda a, b, c: np.cosh(a),
    'TANH': lambda a, b, c: np.tanh(a),
    'RADIANS': lambda a, b, c: a * (pi / 180),
    'DEGREES': lambda a, b, c: a * (180 / pi),
}


def _dot(a, b):
    return (a * b).sum(1, keepdims=True)


def _length(a):
    return np.sqrt(_dot(a, a))


def _project(a, b):
    return _divide(_dot(a, b), _dot(b, b)) * b


def _normalize(a):
    return _divide(a, _length(a))


#: By Blender's name: a function of three (n, 3) vectors and an (n, 1) scale, giving a vector or a value.
VECTOR_MATH = {
    'ADD': lambda a, b, c, s: a + b,
    'SUBTRACT': lambda a, b, c, s: a - b,
    'MULTIPLY': lambda a, b, c, s: a * b,
    'DIVIDE': lambda a, b, c, s: _divide(a, b),
    'MULTIPLY_ADD': lambda a, b, c, s: a * b + c,
    'CROSS_PRODUCT': lambda a, b, c, s: np.cross(a, b),
    'PROJECT': lambda a, b, c, s: _project(a, b),
    'REFLECT': lambda a, b, c, s: a - 2 * _dot(a, _normalize(b)) * _normalize(b),
    'DOT_PRODUCT': lambda a, b, c, s: _dot(a, b),
    'DISTANCE': lambda a, b, c, s: _length(a - b),
    'LENGTH': lambda a, b, c, s: _length(a),
    'SCALE': lambda a, b, c, s: a * s,
    'NORMALIZE': lambda a, b, c, s: _normalize(a),
    'ABSOLUTE': lambda a, b, c, s: np.abs(a),
    'MINIMUM': lambda a, b, c, s: np.minimum(a, b),
    'MAXIMUM': lambda a, b, c, s: np.maximum(a, b),
    'FLOOR': lambda a, b, c, s: np.floor(a),
    'CEIL': lambda a, b, c, s: np.ceil(a),
    'FRACTION': lambda a, b, c, s: a - np.floor(a),
    'MODULO': lambda a, b, c, s: np.where(b == 0, 0, np.fmod(a, np.where(b == 0, 1, b))),
    'WRAP': lambda a, b, c, s: _wrap(a, b, c),
    'SNAP': lambda a, b, c, s: np.floor(_divide(a, b)) * b,
    'SINE': lambda a, b, c, s: np.sin(a),
    'COSINE': lambda a, b, c, s: np.cos(a),
    'TANGENT': lambda a, b, c, s: np.tan(a),
}


def map_range(value, from_low, from_high, to_low, to_high, steps, interpolation: str):
    """The Map Range node, without its clamp."""
    share = _divide(value - from_low, from_high - from_low)
    if interpolation == 'STEPPED':
        share = np.where(steps > 0, _divide(np.floor(share * (steps + 1)), steps), 0)
    elif interpolation == 'SMOOTHSTEP':
        share = np.clip(share, 0, 1)
        share = share**2 * (3 - 2 * share)
    elif interpolation == 'SMOOTHERSTEP':
        share = np.clip(share, 0, 1)
        share = share**3 * (share * (share * 6 - 15) + 10)
    return to_low + share * (to_high - to_low)


def rotate(vectors: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Turn (n, 3) vectors about X, then Y, then Z, by (n, 3) angles in radians."""
    x, y, z = np.broadcast_arrays(vectors, angles)[0].T
    (cos_x, cos_y, cos_z), (sin_x, sin_y, sin_z) = np.cos(angles).T, np.sin(angles).T
    y, z = cos_x * y - sin_x * z, sin_x * y + cos_x * z
    x, z = cos_y * x + sin_y * z, cos_y * z - sin_y * x
    x, y = cos_z * x - sin_z * y, sin_z * x + cos_z * y
    return np.stack([x, y, z], axis=1)


def rotate_back(vectors: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Inverse of `rotate`."""
    x, y, z = np.broadcast_arrays(vectors, angles)[0].T
    (cos_x, cos_y, cos_z), (sin_x, sin_y, sin_z) = np.cos(angles).T, np.sin(angles).T
    x, y = cos_z * x + sin_z * y, cos_z * y - sin_z * x
    x, z = cos_y * x - sin_y * z, sin_y * x + cos_y * z
    y, z = cos_x * y + sin_x * z, cos_x * z - sin_x * y
    return np.stack([x, y, z], axis=1)


def map_vector(kind: str, vectors, location, angles, scale):
    """The Mapping node: `kind` is ``POINT``, ``TEXTURE``, ``VECTOR`` or ``NORMAL``."""
    if kind == 'TEXTURE':
        return _divide(rotate_back(vectors - location, angles), scale)
    if kind == 'NORMAL':
        return _normalize(rotate(_divide(vectors, scale), angles))
    turned = rotate(vectors * scale, angles)
    return turned + location if kind == 'POINT' else turned


def look_up_table(table: np.ndarray, places: np.ndarray, is_stepped: bool = False) -> np.ndarray:
    """Rows of a (TABLE_SIZE, k) table at (n, 1) places from 0 to 1, interpolated unless stepped; the ends continue."""
    place = np.clip(np.nan_to_num(places[:, 0]), 0, 1) * (len(table) - 1)
    low = np.minimum(place.astype(np.int64), len(table) - 2)
    if is_stepped:
        return table[place.astype(np.int64)]
    part = (place - low)[:, None]
    return table[low] * (1 - part) + table[low + 1] * part
