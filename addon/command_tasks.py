"""What the command line was asked to work on: one task a scene file, and where its results go.

All of it is settled before the first file is opened, so that a wrong name costs nothing.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

#: Results by the option that names them, in the order of `Task`.
_SUFFIXES = {"output": ".blend", "report": ".json", "image": ".png", "table": ".csv"}


@dataclass(frozen=True)
class Task:
    """One scene and where its results go; without `source`, the file that is open."""

    source: Path | None
    output: Path | None
    report: Path | None
    image: Path | None
    table: Path | None

    @property
    def results(self) -> list[Path]:
        return [path for path in (self.output, self.report, self.image, self.table) if path]


def plan_tasks(arguments: argparse.Namespace, opened: Path | None) -> list[Task]:
    """Where everything goes.

    Raises
    ------
    ValueError
        If names are missing, collide, or lie in a folder that does not exist.
    """
    sources = [Path(os.path.abspath(name)) for name in arguments.inputs]
    if not sources and opened is None:
        raise ValueError("name a scene file, or open one: blender -b scene.blend --command radiosity bake ...")
    places = {kind: getattr(arguments, kind, None) for kind in _SUFFIXES}
    if not any(places.values()) and arguments.command == "bake":
        raise ValueError("nothing to write: add --output OUT.blend, --report R.json or --image I.png")
    tasks = []
    for source in sources or [None]:
        results = {
            kind: _result_path(kind, place, (source or opened).stem, len(sources) > 1)
            for kind, place in places.items()
            if place
        }
        tasks.append(Task(source, *(results.get(kind) for kind in _SUFFIXES)))
    _refuse_collisions(tasks, opened, places["output"])
    return tasks


def _result_path(kind: str, place: str, stem: str, several: bool) -> Path:
    suffix = _SUFFIXES[kind]
    path = Path(os.path.abspath(place))
    is_folder = path.is_dir() or place.endswith(("/", os.sep))
    if several and not is_folder and path.suffix.lower() == suffix:
        raise ValueError(f"--{kind} {place} names one file for several scenes: give a folder")
    if several or is_folder:
        path = path / f"{stem}{suffix}"
        if path.parent.exists() and not path.parent.is_dir():
            raise ValueError(f"--{kind} {place} is a file: give a folder")
        folder = path.parent.parent  # the folder that is named is made, those above it are not
    else:
        if path.suffix.lower() != suffix:
            raise ValueError(f"--{kind} {place} must end in {suffix}, or be a folder")
        folder = path.parent
    if not folder.is_dir():
        raise ValueError(f"--{kind} {place}: there is no folder {folder}")
    return path


def _refuse_collisions(tasks: list[Task], opened: Path | None, named_output: str | None) -> None:
    results = Counter(path for task in tasks for path in task.results)
    twice = next((path for path, count in results.items() if count > 1), None)
    if twice:
        raise ValueError(f"two scenes would be written to {twice}: bake them into different folders")
    for path in (task.source or opened for task in tasks):
        # A file may be replaced by its baked self, but only where its own name was typed.
        if path in results and path != Path(os.path.abspath(named_output)):
            raise ValueError(f"{path} would be overwritten: name another folder for --output")
