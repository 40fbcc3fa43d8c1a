"""Emission of imported OBJ materials, which the importer of Blender 4.2 drops.

There `Ke` becomes the emission color, at a strength of 0, so that a lamp of the file gives no light. What an importer
gave a strength is left alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import bpy


def restore_emission(path: Path) -> None:
    """Give materials that the MTL files of an OBJ call emissive their strength back.

    Parameters
    ----------
    path : Path
        The OBJ that was just imported into an empty file.
    """
    for name, color in _emissive_materials(path).items():
        material = bpy.data.materials.get(name)
        if material is None or material.node_tree is None:
            continue
        for node in material.node_tree.nodes:
            if node.type == 'BSDF_PRINCIPLED' and node.inputs["Emission Strength"].default_value == 0.0:
                node.inputs["Emission Color"].default_value = (*color, 1.0)
                node.inputs["Emission Strength"].default_value = 1.0


def _emissive_materials(path: Path) -> dict[str, tuple[float, float, float]]:
    """Colors above zero that follow `Ke`, by material name. What cannot be read is left to the importer's warnings."""
    colors = {}
    for library in _libraries(path):
        name = ""
        for words in _lines(path.parent / library):
            if words[0] == "newmtl":
                name = " ".join(words[1:])
            elif words[0] == "Ke" and len(words) == 4 and any(float(word) > 0 for word in words[1:]):
                colors[name] = tuple(float(word) for word in words[1:])
    return colors


def _libraries(path: Path) -> list[str]:
    # They stand before the faces that use them, so that the bulk of a large file need not be read.
    head = takewhile(lambda words: words[0] != "f", _lines(path))
    return [" ".join(words[1:]) for words in head if words[0] == "mtllib"]


def _lines(path: Path) -> Iterator[list[str]]:
    if path.is_file():
        with path.open(encoding="utf-8", errors="replace") as stream:
            for line in stream:
                if words := line.split():
                    yield words
