"""Suns in a picture of the sky: the few bright degrees that give much of its light, as lights of their own.

A hemisphere of even directions meets a sun by chance, and a coarse sky smears its shadows. What is small, round and
strong enough is taken for a disk of even radiance: its direction is the mean of its light's, its size such that as many
steradians of its mean radiance give that light. Long shapes and wide ones stay in the sky.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .sun import SunLight

#: Times the sky's mean radiance from which a place may belong to a sun.
BRIGHT = 10.0

#: Share of the sky's light that a sun gives at least.
STRONG = 0.01

#: Radius around the brightest place within which all that is bright belongs to one sun, in radians: 8 degrees.
REACH = 0.14

#: Part of its light that may lie around it, up to one and a half times as far: what is wider than that is no sun.
APART = 0.1

#: How far its light may spread, RMS, in radii of the disk that it is taken for; 0.71 for that disk itself.
ROUND = 1.0

#: Suns looked for at most.
MOST = 8


@dataclass(frozen=True)
class SkySun:
    """A sun, the cosine of the angle around it within which its light lies, and the radiance (3,) that it leaves there,
    which is the mean of the sky."""

    light: SunLight
    cosine: float
    mean: np.ndarray

    def taken_out(self, directions: np.ndarray, radiance: np.ndarray) -> np.ndarray:
        """Radiance (..., 3) from directions (..., 3) without the sun."""
        inside = (directions @ self.light.direction >= self.cosine) & _is_bright(radiance, self.mean)
        return np.where(inside[..., None], np.minimum(radiance, self.mean), radiance)


def find_suns(directions: np.ndarray, radiance: np.ndarray, solid_angles: np.ndarray, mean: np.ndarray) -> list[SkySun]:
    """Suns among places of a sky.

    Parameters
    ----------
    directions : (n, 3) float
        Unit vectors to all `bright_places`.
    radiance : (n, 3) float
        In W/(m2 sr).
    solid_angles : (n,) float
        In sr.
    mean : (3,) float
        Mean radiance of the whole sky.
    """
    suns = []
    left = np.arange(len(directions))
    while len(left) and len(suns) < MOST:
        seed = directions[left[radiance[left].max(axis=1).argmax()]]
        inside = directions[left] @ seed >= np.cos(REACH)
        who, left = left[inside], left[~inside]
        light = (radiance[who] * solid_angles[who, None]).sum(axis=0)
        near = directions @ seed
        around = (near < np.cos(REACH)) & (near >= np.cos(1.5 * REACH))
        outside = (radiance[around] * solid_angles[around, None]).sum(axis=0)
        if light.max() < STRONG * 4 * np.pi * mean.max() or outside.max() > APART * light.max():
            continue
        weight = radiance[who].max(axis=1) * solid_angles[who]
        middle = weight @ directions[who]
        middle /= np.linalg.norm(middle)
        # Of even radiance the sum of squares tells the size.
        size = weight.sum() ** 2 / (weight * radiance[who].max(axis=1)).sum()
        radius = np.arccos(max(1 - size / (2 * np.pi), -1.0))
        away = np.arccos(np.clip(directions[who] @ middle, -1, 1))
        if np.sqrt((weight @ away**2) / weight.sum()) > ROUND * radius + _step(solid_angles[who]):
            continue
        excess = light - (np.minimum(radiance[who], mean) * solid_angles[who, None]).sum(axis=0)
        sun = SunLight(direction=middle, irradiance=excess, angle=2 * float(radius))
        # Half-way to the next place, so that rounding leaves none out.
        suns.append(SkySun(sun, float(np.cos(away.max() + 0.5 * _step(solid_angles[who]))), mean))
    return suns


def bright_places(radiance: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, ...]:
    """Indices, one array per axis but the last, of the places of radiance (..., 3) that `find_suns` wants."""
    return np.nonzero(_is_bright(radiance, mean))


def _is_bright(radiance: np.ndarray, mean: np.ndarray) -> np.ndarray:
    return radiance.max(axis=-1) > BRIGHT * mean.max()


def _step(solid_angles: np.ndarray) -> float:
    """Side of the largest place."""
    return float(np.sqrt(solid_angles.max()))
