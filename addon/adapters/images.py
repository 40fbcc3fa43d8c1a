"""Images as pixels, and how they are looked up.

Pixels are asked from Blender once per image and kept as float32. Images with more than `MAX_SIDE` pixels on a side are
reduced by area averaging of their linear colors: the bake uses means over patches, to which finer detail adds nothing.
As in Cycles, bytes in sRGB are interpolated before they are decoded, and alpha is multiplied into the colors as they
are stored; where a material uses the alpha too, it is divided out again before decoding. Known limits: of a tiled image
(UDIM) only the first tile is read, of a movie or sequence the current frame; color spaces other than those named here
are taken for sRGB (bytes) or linear (floats), and a warning says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

#: Largest side of a surface texture in pixels, and of an environment, where single pixels may hold the sun.
MAX_SIDE = 1024
MAX_ENVIRONMENT_SIDE = 4096

_LINEAR_SPACES = {'Linear Rec.709', 'Linear', 'Linear BT.709', 'scene_linear', 'Raw'}
_DATA_SPACES = {'Non-Color', 'Raw', 'Generic Data'}


@dataclass(frozen=True)
class Texture:
    """Pixels of an image.

    Parameters
    ----------
    pixels : (rows, columns, 4) float32
        Bottom row first; alpha is multiplied into the colors unless `is_straight`.
    is_straight : bool
        Whether colors and alpha are unrelated (no alpha, data, packed channels).
    is_encoded : bool
        Whether colors are encoded in sRGB, else scene-linear.
    """

    pixels: np.ndarray
    is_straight: bool
    is_encoded: bool

    def colors(self, pixels: np.ndarray, divide_alpha: bool) -> np.ndarray:
        """(n, 4) linear colors of pixels (n, 4) that were looked up, with the alpha divided out on request."""
        colors, alpha = pixels[:, :3], pixels[:, 3:]
        if divide_alpha and not self.is_straight:
            colors = colors / np.where(alpha == 0, 1, alpha)
        if self.is_encoded:
            colors = srgb_to_linear(colors)
        return np.concatenate([colors, alpha], axis=1)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Decode the sRGB transfer curve (IEC 61966-2-1) elementwise."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Inverse of `srgb_to_linear`."""
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055)


class ImageLibrary:
    """Reads each image once. What could not be read as it is goes into `problems` (kind, image name)."""

    def __init__(self) -> None:
        self.problems: list[tuple[str, str]] = []
        self._known: dict[tuple[int, int], Texture | None] = {}

    def texture(self, image: bpy.types.Image, max_side: int = MAX_SIDE) -> Texture | None:
        """Pixels of an image, or None (and a problem noted) where it is missing or empty."""
        key = (image.as_pointer(), max_side)
        if key not in self._known:
            self._known[key] = self._load(image, max_side)
        return self._known[key]

    def rows_of_environments(self) -> list[int]:
        """Rows of the images that were read at the size of environments."""
        known = self._known.items()
        return [each.pixels.shape[0] for (_, side), each in known if each is not None and side == MAX_ENVIRONMENT_SIDE]

    def _load(self, image: bpy.types.Image, max_side: int) -> Texture | None:
        columns, rows = image.size
        # Size and pixels are what Blender could load: a missing file has none, whatever `has_data` says before.
        if columns == 0 or rows == 0 or len(image.pixels) != columns * rows * image.channels:
            self.problems.append(("missing", image.name))
            return None
        pixels = np.empty(columns * rows * image.channels, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        pixels = _four_channels(pixels.reshape(rows, columns, image.channels))
        if image.source == 'TILED':
            self.problems.append(("tiled", image.name))
        space = image.colorspace_settings.name
        is_data = space in _DATA_SPACES
        is_encoded = not image.is_float and not is_data and space not in _LINEAR_SPACES
        if space != 'sRGB' and not is_data and space not in _LINEAR_SPACES:
            self.problems.append(("color space", f"{image.name} ({space})"))
        is_straight = is_data or image.alpha_mode in ('NONE', 'CHANNEL_PACKED')
        if image.alpha_mode == 'NONE':
            pixels[..., 3] = 1
        if max(rows, columns) > max_side:
            pixels = _reduce(pixels, max_side, is_encoded, is_straight, image.is_float)
        elif not is_straight and not image.is_float:  # Blender keeps bytes straight and floats multiplied
            pixels[..., :3] *= pixels[..., 3:]
        return Texture(pixels, is_straight, is_encoded)


def _reduce(pixels, max_side, is_encoded, is_straight, is_multiplied):
    """Average linear light over area, and return to how the pixels of a `Texture` are kept."""
    if is_encoded:
        # A table of all byte values is exact and many times faster than the power function per pixel.
        table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
        pixels[..., :3] = table[np.rint(np.clip(pixels[..., :3], 0, 1) * 255).astype(np.uint8)]
    if not is_straight and not is_multiplied:
        pixels[..., :3] *= pixels[..., 3:]
    pixels = reduce_by_area(pixels, max_side)
    if is_encoded:
        alpha = 1 if is_straight else pixels[..., 3:]
        pixels[..., :3] = linear_to_srgb(pixels[..., :3] / np.where(alpha == 0, 1, alpha)) * alpha
    return pixels


def _four_channels(pixels: np.ndarray) -> np.ndarray:
    """Red, green, blue, alpha from 1 to 4 channels."""
    channels = pixels.shape[-1]
    if channels == 4:
        return pixels
    alpha = pixels[..., 1:2] if channels == 2 else np.ones_like(pixels[..., :1])
    colors = pixels if channels == 3 else np.repeat(pixels[..., :1], 3, axis=-1)
    return np.concatenate([colors, alpha], axis=-1)


def overlap_weights(fine: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Share of each coarse interval that each fine one covers.

    Parameters
    ----------
    fine, coarse : (n + 1,), (m + 1,) float
        Increasing borders of the intervals over the same range.

    Returns
    -------
    (m, n) float
        Rows sum to 1.
    """
    low = np.maximum(coarse[:-1, None], fine[None, :-1])
    high = np.minimum(coarse[1:, None], fine[None, 1:])
    return np.maximum(high - low, 0) / np.diff(coarse)[:, None]


def reduce_by_area(pixels: np.ndarray, max_side: int) -> np.ndarray:
    """Average over area to at most `max_side` pixels on a side; the mean of all pixels is kept."""
    for axis in (0, 1):
        count = pixels.shape[axis]
        if count > max_side:
            weights = overlap_weights(np.linspace(0, 1, count + 1), np.linspace(0, 1, max_side + 1)).astype(np.float32)
            pixels = np.moveaxis(np.tensordot(weights, pixels, axes=(1, axis)), 0, axis)
    return np.ascontiguousarray(pixels)


def look_up(pixels: np.ndarray, coordinates: np.ndarray, extension: str, interpolation: str) -> np.ndarray:
    """Colors of an image at texture coordinates.

    Parameters
    ----------
    pixels : (rows, columns, 4) float32
    coordinates : (n, 2 or more) float
        From 0 to 1 over the image, v upward.
    extension : str
        ``REPEAT``, ``EXTEND``, ``CLIP`` (transparent black outside) or ``MIRROR``.
    interpolation : str
        ``Closest`` takes one pixel; everything else interpolates linearly.

    Returns
    -------
    (n, 4) float32
    """
    rows, columns = pixels.shape[:2]
    uv = np.where(np.isfinite(coordinates[:, :2]), coordinates[:, :2], 0).astype(np.float64)
    is_closest = interpolation == 'Closest'
    place = uv * (columns, rows) - (0 if is_closest else 0.5)
    low = np.floor(place).astype(np.int64)
    if is_closest:
        return _pixels_at(pixels, low[:, 0], low[:, 1], extension)
    part = (place - low).astype(np.float32)
    result = np.zeros((len(uv), 4), dtype=np.float32)
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            result += weight[:, None] * _pixels_at(pixels, low[:, 0] + dx, low[:, 1] + dy, extension)
    return result


def _pixels_at(pixels: np.ndarray, column: np.ndarray, row: np.ndarray, extension: str) -> np.ndarray:
    """(n, 4) pixels at whole coordinates that may lie outside."""
    rows, columns = pixels.shape[:2]
    if extension == 'REPEAT':
        return pixels[row % rows, column % columns]
    if extension == 'MIRROR':
        row, column = (np.where(i % (2 * n) < n, i % n, n - 1 - i % n) for i, n in ((row, rows), (column, columns)))
        return pixels[row, column]
    inside = pixels[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
    if extension == 'CLIP':
        return inside * ((row >= 0) & (row < rows) & (column >= 0) & (column < columns))[:, None]
    return inside
