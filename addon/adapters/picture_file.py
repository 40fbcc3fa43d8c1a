"""Pictures on disk: the whole file or none."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...core.errors import RadiosityError
from ...core.rendering.png import encode_png


class PictureFileError(RadiosityError):
    """A picture cannot be written."""


def write_picture(path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Write (h, w, 3) uint8 pixels as a PNG file; an old file of that name stays until the new one is complete.

    Raises
    ------
    PictureFileError
        If the name does not end in .png, the folder is missing, or the disk refuses.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise PictureFileError(f"Pictures are written as PNG: give {path.name!r} the ending .png")
    data = encode_png(pixels)
    # In the same folder, so that the move cannot cross file systems; the process number keeps parallel jobs apart.
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise PictureFileError(f"Cannot write the picture {path}: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)
