"""From scene-linear light to the 8 bits of a screen: luminance, exposure, highlights, sRGB, dithering.

A bake stores light without an upper end; a screen shows 0 to 1. Exposure is one factor for a whole picture, chosen from
its colors alone, so the same picture is always exposed alike. It is a display matter: stored values stay untouched.

Limits: exposure looks at a histogram, not at where things are; a picture that is meant to be dark comes out bright.
"""

from __future__ import annotations

import numpy as np

#: Share of each linear Rec.709 primary in luminance (ITU-R BT.709-6, item 3.2).
LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])

#: Display value given to the geometric mean of the picture: the photographic middle gray is 0.18; rooms with white
#: walls look underexposed by it, so it lies somewhat above.
_MEAN_KEY = 0.24

#: Display value that the brightest surfaces (`_BRIGHT_PERCENTILE` of them) should reach, in linear units.
_BRIGHT_KEY = 0.85
_BRIGHT_PERCENTILE = 97.0

#: The two wishes above rarely agree. The mean may push bright surfaces over their key by this factor, into the shoulder
#: of `compress_highlights`, and no further: white walls under it keep their shading, at 229 of 255 or so.
_OVEREXPOSURE = 1.4

#: Below this share of the bright surfaces all is black to the eye: clamps the logarithm.
_BLACK = 1e-3

#: Linear display value above which `compress_highlights` bends. Higher, and what is twice too bright turns to paper.
_SHOULDER = 0.5


def luminance(colors: np.ndarray) -> np.ndarray:
    """Luminance (...) of scene-linear Rec.709 colors (..., 3), in the unit of the colors."""
    return np.asarray(colors) @ LUMINANCE_WEIGHTS.astype(np.result_type(colors, np.float32))


def exposure_scale(colors: np.ndarray) -> float:
    """Factor that makes a picture of these colors well exposed.

    A compromise of the geometric mean at middle gray (the log-average of Reinhard et al. [1]_) and bright surfaces just
    below white. The factor scales inversely with the light: twice the light gives half the factor. What counts is the
    strongest channel, not luminance: a saturated wall would leave the range of the screen and turn pale.

    Parameters
    ----------
    colors : (n, 3) float
        Of the lit surfaces in the picture, any order. Those without a finite positive channel are left out.

    Returns
    -------
    float
        1 where nothing is lit.

    References
    ----------
    .. [1] Reinhard, Stark, Shirley, Ferwerda, "Photographic Tone Reproduction for Digital Images",
       SIGGRAPH 2002, eq. 1.
    """
    strongest = np.asarray(colors, dtype=np.float64).reshape(-1, 3).max(axis=1)
    lit = strongest[np.isfinite(strongest) & (strongest > 0)]
    if not lit.size:
        return 1.0
    bright = float(np.percentile(lit, _BRIGHT_PERCENTILE))
    # Scaled to the bright surfaces first: neither tiny nor huge light may leave the range of floats.
    mean = bright * float(np.exp(np.mean(np.log(np.maximum(lit / bright, _BLACK)))))
    by_mean, by_bright = _MEAN_KEY / mean, _BRIGHT_KEY / bright
    return min(max(by_bright, by_mean), _OVEREXPOSURE * by_bright)


def compress_highlights(colors: np.ndarray) -> np.ndarray:
    """Bend values above the shoulder so that all of [0, infinity] fits into [0, 1], smoothly and in order.

    Each channel on its own: strong lights of any color turn whiter as they do on film. Negative values and NaN become
    0.
    """
    # 1e30 is white, and leaves float32 room for the division below.
    colors = np.clip(np.nan_to_num(colors, nan=0.0), 0, 1e30)
    room = 1 - _SHOULDER
    over = np.maximum(colors - _SHOULDER, 0) / room
    # x / (1 + x) leaves the shoulder with slope 1, so no edge shows.
    return np.where(over > 0, _SHOULDER + room * over / (1 + over), colors)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB-encoded values of linear ones, clipped to [0, 1] (IEC 61966-2-1)."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """Linear values of sRGB-encoded ones in [0, 1] (IEC 61966-2-1)."""
    encoded = np.clip(encoded, 0, 1)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def dither_to_bytes(encoded: np.ndarray, first_row: int = 0) -> np.ndarray:
    """(h, w, 3) uint8 of encoded values in [0, 1], rounded up or down so that areas keep their mean.

    Soft shading spans few of 256 steps; rounding alone shows them as bands. The threshold of each pixel comes from a
    fixed additive sequence in two dimensions [1]_, whose neighbors differ strongly, so the pattern is too fine to see.

    Parameters
    ----------
    encoded : (h, w, 3) float
    first_row : int
        Row of the picture that row 0 is, so that pictures can be made in bands.

    References
    ----------
    .. [1] Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018, the R2 sequence.
    """
    rows = np.arange(first_row, first_row + encoded.shape[0])[:, None, None]
    columns = np.arange(encoded.shape[1])[None, :, None]
    channels = np.arange(3)[None, None, :]
    # Powers of the inverse plastic number; a third of a step between channels keeps grays from flickering together.
    threshold = (0.7548776662466927 * columns + 0.5698402909980532 * rows + channels / 3) % 1.0
    return np.clip(np.floor(encoded * 255 + threshold), 0, 255).astype(np.uint8)
