"""A whole comparison of methods in Blender as one generator: read the scene, bake it every way, keep what was found.

No mesh is written. What was found is kept with the scene as JSON, and as a plot among the images.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Generator, Sequence
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from ...core.errors import RadiosityError
from ...core.progress import Progress
from ...core.rendering.plot import Line, error_plot
from ...core.settings import METHODS
from ...core.verification.comparison import Comparison, Trial, compare_steps
from ...core.verification.verification import PLACES
from .bake_settings import BakeOptions
from .lettering import lettering
from .preview_material import artist_materials
from .report import plain
from .scene_reader import read_scene

#: Custom property of a scene that holds its last comparison, and the image that shows it.
COMPARISON_KEY = "radiosity_comparison"
IMAGE_NAME = "Radiosity Comparison"

COLUMNS = (
    "method", "accuracy", "seconds", "rays", "estimated_error", "measured_error", "measured_error_low",
    "measured_error_high", "recommended", "refusal",
)  # fmt: skip

_READ_SHARE = 0.02


def compare_job_steps(
    context: bpy.types.Context,
    options: BakeOptions,
    methods: Sequence[str] = METHODS,
    accuracies: Sequence[float] | None = None,
    places: int = PLACES,
) -> Generator[Progress, None, dict[str, Any]]:
    """Compare methods on the scene of a context.

    Parameters
    ----------
    context : bpy.types.Context
        Used until the scene is read.
    options : BakeOptions
        Of the bake that is meant; its accuracy is what is asked for.
    methods, accuracies, places
        As in `compare_steps`.

    Returns
    -------
    dict
        ``asked``, ``keeps`` and ``trials``, a list of dicts by `COLUMNS`; also stored with the scene.

    Raises
    ------
    RadiosityError
        For all that the user can mend; then nothing was changed.
    """
    yield Progress(0.0, "Reading the scene")
    name = context.scene.name
    with artist_materials(context.scene.objects):
        scene = read_scene(context, world_strength=options.world_strength).scene
    work = compare_steps(scene, options.settings, methods, accuracies, places)
    try:
        while True:
            try:
                progress = next(work)
            except StopIteration as end:
                found = end.value
                break
            yield Progress(_READ_SHARE + (1 - _READ_SHARE) * progress.fraction, progress.message)
    finally:
        work.close()
    kept = bpy.data.scenes.get(name)
    if kept is None:
        raise RadiosityError(f"Scene {name!r} was removed meanwhile: nothing was stored")
    comparison = _document(found)
    kept[COMPARISON_KEY] = json.dumps(comparison, allow_nan=False)
    return comparison


def read_comparison(scene: bpy.types.Scene) -> dict[str, Any] | None:
    """The last comparison of a scene, or None."""
    return _parsed(scene.get(COMPARISON_KEY))


def remove_comparison(scene: bpy.types.Scene) -> None:
    """Forget the last comparison, its plot included."""
    if COMPARISON_KEY in scene:
        del scene[COMPARISON_KEY]
    image = bpy.data.images.get(IMAGE_NAME)
    if image is not None:
        bpy.data.images.remove(image)


def comparison_table(comparison: dict[str, Any]) -> str:
    """CSV with a line per trial; errors are shares, empty where nothing was measured."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(comparison["trials"])
    return text.getvalue()


def comparison_picture(comparison: dict[str, Any], title: str) -> np.ndarray | None:
    """Plot (h, w, 3) uint8 of error against time; None where every method was refused."""
    if not any(trial["recommended"] for trial in comparison["trials"]):
        return None
    lines: dict[str, list] = {}
    marked: dict[str, int] = {}
    for trial in comparison["trials"]:
        points = lines.setdefault(trial["method"], [])
        if trial["measured_error"] is None:
            continue
        if trial["recommended"]:
            marked[trial["method"]] = len(points)
        # What is 0 has no place on a logarithmic axis.
        points.append((max(trial["seconds"], 1e-4), max(trial["measured_error"], 1e-6)))
    shown = [Line(name, np.array(points).reshape(-1, 2), marked.get(name)) for name, points in lines.items()]
    return error_plot(shown, comparison["asked"], title, lettering)


def show_comparison(comparison: dict[str, Any], title: str) -> bpy.types.Image | None:
    """Put the plot among Blender's images, packed, in place of an earlier one; returns it."""
    pixels = comparison_picture(comparison, title)
    if pixels is None:
        return None
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(IMAGE_NAME)
    if image is not None:
        bpy.data.images.remove(image)
    image = bpy.data.images.new(IMAGE_NAME, width, height)
    values = np.ones((height, width, 4), np.float32)
    values[..., :3] = pixels[::-1] / np.float32(255)
    image.pixels.foreach_set(values.ravel())
    image.update()
    image.pack()
    return image


def advice(comparison: dict[str, Any]) -> str:
    """What to take, in one line."""
    trial = next((trial for trial in comparison["trials"] if trial["recommended"]), None)
    if trial is None:
        return "no method could bake this scene"
    line = (
        f"recommended {trial['method']} at accuracy {trial['accuracy']:.3g}: measured error "
        f"{trial['measured_error']:.2%} in {trial['seconds']:.1f} s"
    )
    return line if comparison["keeps"] else f"{line}; none keeps the {comparison['asked']:.3g} asked for"


def trial_line(trial: dict[str, Any]) -> str:
    """One trial in one line."""
    start = f"{trial['method']} at {trial['accuracy']:.3g}: "
    if trial["measured_error"] is None:
        return start + trial["refusal"]
    low, high = trial["measured_error_low"], trial["measured_error_high"]
    return start + f"{trial['seconds']:.2f} s, measured error {trial['measured_error']:.2%} ({low:.2%} to {high:.2%})"


def _document(found: Comparison) -> dict[str, Any]:
    trials = [_entry(trial, number == found.recommended) for number, trial in enumerate(found.trials)]
    return plain({"asked": found.asked, "keeps": found.keeps, "trials": trials})


def _entry(trial: Trial, recommended: bool) -> dict[str, Any]:
    measured = trial.measured
    errors = (None, None, None) if measured is None else (measured.error, measured.low, measured.high)
    values = (
        trial.method, trial.accuracy, trial.seconds, trial.rays, trial.estimated_error, *errors, recommended,
        " ".join(trial.refusal.split()),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


@lru_cache(maxsize=8)  # panels ask at every redraw
def _parsed(text: Any) -> dict[str, Any] | None:
    if not isinstance(text, str):
        return None
    try:
        comparison = json.loads(text)
    except ValueError:  # edited by hand
        return None
    return comparison if isinstance(comparison, dict) and isinstance(comparison.get("trials"), list) else None
