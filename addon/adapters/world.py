"""The world as a sky: its background evaluated over all directions.

The node tree is evaluated on an equirectangular grid, as fine as the largest image in it, and averaged to the sky's
equal-area grid by exact overlap. A sun of a few pixels becomes a light of its own, with its own size. Limits: Sky
Texture nodes and noise are replaced by their sockets' values, with a warning; volumes are ignored.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import bpy
import numpy as np

from ...core.lights import SunLight
from ...core.lights.sky_suns import SkySun, bright_places, find_suns
from ...core.scene import Sky
from .fields import Field, Samples, constant
from .images import MAX_ENVIRONMENT_SIDE, ImageLibrary, overlap_weights
from .materials import find_output, node_tree_of
from .node_closures import compile_closure
from .node_graph import find_input
from .node_values import ValueCompiler

#: Cells of the sky in height and azimuth: 2.8 degrees at the horizon.
SKY_ROWS, SKY_COLUMNS = 64, 128

#: Least rows of the grid that is evaluated; images may ask for more.
LEAST_ROWS = 256

#: Directions evaluated at once.
CHUNK = 1 << 18


def read_world(
    world: bpy.types.World | None, images: ImageLibrary, strength: float | None = None
) -> tuple[Sky | None, list[SunLight], list[str]]:
    """The sky of a world, and the suns in it.

    Parameters
    ----------
    world : bpy.types.World or None
    images : ImageLibrary
    strength : float or None
        Replaces the strength of the background; white where there is no world or it is black.

    Returns
    -------
    sky : Sky or None
        None where the sky is black.
    suns : list of SunLight
        What is taken out of the sky as lights of their own.
    warnings : list of str
    """
    if world is None:
        return (None if not strength else _uniform(strength, (1, 1, 1))), [], []
    tree = node_tree_of(world)
    if tree is None:
        color = np.array(world.color, dtype=np.float64)
        if strength is None:
            return _uniform(1.0, color), [], []
        return _uniform(strength, color if color.any() else (1, 1, 1)), [], []
    values = ValueCompiler(images, is_world=True, max_side=MAX_ENVIRONMENT_SIDE, background_strength=strength)
    output = find_output(tree, 'ShaderNodeOutputWorld')
    surface = find_input(output, "Surface") if output else None
    radiance = compile_closure(surface, None, values).emission if surface else constant(0.0, 0.0, 0.0)
    warnings = []
    if values.unsupported:
        warnings.append(
            f"World {world.name}: nodes that cannot be baked were replaced by their sockets' own values: "
            f"{', '.join(values.unsupported)}"
        )
    suns = []
    if radiance.attributes:
        rows = _rows_of(images)
        cells = np.maximum(average_over_cells(radiance, rows), 0)
        suns = _suns(radiance, rows, cells)
        if suns:
            cells = np.maximum(average_over_cells(radiance, rows, suns), 0)
        sky = Sky(cells)
    else:
        sky = _uniform(1.0, np.nan_to_num(np.maximum(radiance.constant, 0)))
    is_black = sky is None or not sky.radiance.any()
    if strength and is_black and not suns:
        return _uniform(strength, (1, 1, 1)), [], warnings
    return (None if is_black else sky), [sun.light for sun in suns], warnings


def _uniform(strength: float, color) -> Sky | None:
    radiance = np.maximum(np.asarray(color, dtype=np.float64) * strength, 0)
    return Sky(radiance.reshape(1, 1, 3)) if radiance.any() else None


def _rows_of(images: ImageLibrary) -> int:
    """Rows of the evaluated grid: those of the largest environment, each of whose pixels is then asked for."""
    return max([LEAST_ROWS, *images.rows_of_environments()])


def average_over_cells(radiance: Field, rows: int, suns: list[SkySun] | tuple = ()) -> np.ndarray:
    """(SKY_ROWS, SKY_COLUMNS, 3) mean radiance of each cell, from an equirectangular grid of so many rows; `suns` are
    left out of it."""
    columns = 2 * rows
    heights = np.linspace(-1, 1, SKY_ROWS + 1)
    by_row = overlap_weights(np.sin(np.linspace(-pi / 2, pi / 2, rows + 1)), heights)
    by_column = overlap_weights(np.linspace(0, 1, columns + 1), np.linspace(0, 1, SKY_COLUMNS + 1))
    result = np.zeros((SKY_ROWS, SKY_COLUMNS, 3))
    for start, directions, values in _evaluated(radiance, rows):
        for sun in suns:
            values = sun.taken_out(directions, values)
        banded = np.einsum("cw,rwk->rck", by_column, values, optimize=True)
        result += np.einsum("hr,rck->hck", by_row[:, start : start + len(values)], banded, optimize=True)
    return result


def _evaluated(radiance: Field, rows: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """First row, directions (r, columns, 3) and radiance (r, columns, 3) of some rows at a time of the grid."""
    columns = 2 * rows
    azimuth = (np.arange(columns) + 0.5) * (2 * pi / columns)
    step = max(1, CHUNK // columns)
    for start in range(0, rows, step):
        elevation = ((np.arange(start, min(start + step, rows)) + 0.5) / rows - 0.5) * pi
        count = len(elevation) * columns
        directions = np.empty((len(elevation), columns, 3), dtype=np.float32)
        directions[..., 0] = np.cos(elevation)[:, None] * np.cos(azimuth)
        directions[..., 1] = np.cos(elevation)[:, None] * np.sin(azimuth)
        directions[..., 2] = np.sin(elevation)[:, None]
        values = radiance(Samples({('direction', ""): directions.reshape(-1, 3)}, count))
        yield start, directions, np.broadcast_to(np.nan_to_num(values), (count, 3)).reshape(len(elevation), columns, 3)


def _suns(radiance: Field, rows: int, cells: np.ndarray) -> list[SkySun]:
    mean = cells.mean(axis=(0, 1))
    if not len(bright_places(cells, mean)[0]):
        return []  # a sun brightens the cell around it, too
    bands = np.diff(np.sin(np.linspace(-pi / 2, pi / 2, rows + 1))) * (pi / rows)
    found = [[np.empty((0, 3))], [np.empty((0, 3))], [np.empty(0)]]
    for start, directions, values in _evaluated(radiance, rows):
        row, column = bright_places(values, mean)
        found[0].append(directions[row, column].astype(np.float64))
        found[1].append(values[row, column].astype(np.float64))
        found[2].append(bands[start + row])
    return find_suns(*(np.concatenate(part) for part in found), mean)
