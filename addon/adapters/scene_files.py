"""Scene files: open what Blender can read, and save so that a file appears complete or not at all.

Python scripts inside a .blend stay off unless asked for. Other formats are imported into an empty file with Blender's
own importers. What an importer says on the console is not an error; a file that brings no mesh is refused later, by the
bake.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import addon_utils
import bpy

from ...core.errors import RadiosityError
from .obj_emission import restore_emission

# Importers per file name ending, the first that this Blender has is taken: FBX got a built-in one in 4.5, and some
# distributions build Blender without USD.
IMPORTERS = {
    ".gltf": ("import_scene.gltf",),
    ".glb": ("import_scene.gltf",),
    ".obj": ("wm.obj_import",),
    ".ply": ("wm.ply_import",),
    ".fbx": ("wm.fbx_import", "import_scene.fbx"),
    ".usd": ("wm.usd_import",),
    ".usda": ("wm.usd_import",),
    ".usdc": ("wm.usd_import",),
    ".usdz": ("wm.usd_import",),
}

# Importers written in Python live in add-ons that a user may have switched off.
_IMPORTER_ADDONS = {"import_scene.gltf": "io_scene_gltf2", "import_scene.fbx": "io_scene_fbx"}


def open_scene(path: Path, enable_scripts: bool = False) -> None:
    """Make a scene file Blender's current file.

    Parameters
    ----------
    path : Path
        A .blend, or a file of a kind in `IMPORTERS`.
    enable_scripts : bool
        Whether Python scripts and drivers inside a .blend may run.

    Raises
    ------
    RadiosityError
        If the file is missing, of an unknown kind, or cannot be read.
    """
    if not path.is_file():
        raise RadiosityError(f"{path} does not exist: check the name")
    kind = path.suffix.lower()
    if kind == ".blend":
        _open_blend(path, enable_scripts)
    elif kind in IMPORTERS:
        # Empty, so that nothing of the user's start-up file takes part in the bake.
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        _import(path, IMPORTERS[kind])
        if kind == ".obj":
            restore_emission(path)
    else:
        known = ", ".join((".blend", *IMPORTERS))
        raise RadiosityError(f"{path} is of an unknown kind: give one of {known}")


def _open_blend(path: Path, enable_scripts: bool) -> None:
    try:
        # With its windows: they would be replaced by Blender's own in the file that is saved.
        result = bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=True, use_scripts=enable_scripts)
    except RuntimeError as error:
        raise RadiosityError(f"{path} cannot be opened: {_reason(error)}") from error
    if 'FINISHED' not in result:
        raise RadiosityError(f"{path} cannot be opened by Blender {bpy.app.version_string}")


def _import(path: Path, names: tuple[str, ...]) -> None:
    for name in names:
        if name in _IMPORTER_ADDONS:
            addon_utils.enable(_IMPORTER_ADDONS[name], default_set=False)
        module, function = name.split(".")
        operator = getattr(getattr(bpy.ops, module), function)
        try:
            operator.get_rna_type()
        except KeyError:
            continue
        try:
            result = operator(filepath=str(path))
        except RuntimeError as error:
            raise RadiosityError(f"{path} cannot be imported: {_reason(error)}") from error
        if 'FINISHED' not in result:
            raise RadiosityError(f"{path} cannot be imported: it may be damaged or empty")
        return
    raise RadiosityError(f"{path} cannot be imported: this Blender was built without support for {path.suffix} files")


def save_scene(path: Path) -> None:
    """Save a copy of the current file, uncompressed, without a backup; `path` must be new.

    Raises
    ------
    RadiosityError
        If it cannot be written, for instance because the disk is full.
    """
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=False, check_existing=False)
    except RuntimeError as error:
        raise RadiosityError(f"Blender cannot save it: {_reason(error)}") from error


def write_all_or_nothing(writers: Mapping[Path, Callable[[Path], None]]) -> None:
    """Write several files so that each appears complete, and none appears when one cannot be written.

    Each is written under another name in its own folder, which is made if missing: relative paths inside the file hold,
    and what remains is to rename, which either happens or does not.

    Parameters
    ----------
    writers : mapping of Path to callable
        For each file, what writes it to the path it is given.

    Raises
    ------
    RadiosityError
        If one cannot be written; the text names it.
    """
    temporaries: dict[Path, Path] = {}
    try:
        for path, write in writers.items():
            with _named(path, temporaries):
                path.parent.mkdir(exist_ok=True)
                temporaries[path] = _new_name_beside(path)
                write(temporaries[path])
        for path, temporary in temporaries.items():
            with _named(path, temporaries):
                os.replace(temporary, path)
    finally:
        for temporary in temporaries.values():
            temporary.unlink(missing_ok=True)


def _new_name_beside(path: Path) -> Path:
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    # Only the name is wanted: Blender makes a backup of a file that is there, and mkstemp lets nobody else read it.
    os.unlink(name)
    return Path(name)


@contextmanager
def _named(path: Path, temporaries: Mapping[Path, Path]) -> Iterator[None]:
    """Errors name the file that was asked for, not the one that is written meanwhile."""
    try:
        yield
    except OSError as error:
        raise RadiosityError(f"{path} cannot be written: {error.strerror or error}") from error
    except RadiosityError as error:
        text = str(error).replace(str(temporaries.get(path, path)), str(path))
        raise RadiosityError(f"{path} cannot be written: {text}") from error


def _reason(error: RuntimeError) -> str:
    """The last line of what an operator reported, without its heading."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].removeprefix("Error: ") if lines else "Blender gives no reason"
