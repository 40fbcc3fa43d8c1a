"""The report of a bake: one JSON document with what was done, how long it took and how wrong it may be.

It is stored as text in ``scene["radiosity_report"]``; command line and panel read it from there. `VERSION` changes when
a name is removed or changes its meaning; new names may appear without.
"""

from __future__ import annotations

import json
import math
import tomllib
from functools import lru_cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

#: Custom property of a scene that holds the last report.
REPORT_KEY = "radiosity_report"

VERSION = 1

#: What belongs to the scene; all else that the core counts stays at the top.
_SCENE_COUNTS = ("objects", "faces", "vertices", "triangles", "patches", "elements", "receivers", "lights")

_ALWAYS = (
    "rays", "peak_memory", "peak_memory_above_start", "converged", "iterations", "light_absorbed",
    "energy_balance_error", "closure_error_max", "reciprocity_error_max", "estimated_error",
)  # fmt: skip


@lru_cache(maxsize=1)
def radiosity_version() -> str:
    """Version of the extension, from its manifest."""
    manifest = Path(__file__).parents[2] / "blender_manifest.toml"
    return tomllib.loads(manifest.read_text(encoding="utf-8"))["version"]


def make_report(
    *,
    scene_name: str,
    counts: dict[str, int],
    settings: dict[str, Any],
    statistics: dict[str, Any],
    seconds: dict[str, float],
    memory: tuple[int, int],
    warnings: list[str],
    skipped: list[dict[str, str]],
) -> dict[str, Any]:
    """Report as a dict that JSON can hold: plain numbers, None for those that are not finite.

    Parameters
    ----------
    scene_name : str
    counts : dict
        What the scene reader counted.
    settings : dict
        `BakeOptions.as_dict()`.
    statistics : dict
        `BakeResult.statistics`; passes through.
    seconds : dict
        Seconds of the stages outside the core, `total` included.
    memory : (int, int)
        Peak of the process and peak above the start, in bytes.
    warnings : list of str
    skipped : list of dict
        ``object`` and ``reason`` of what was left out.

    Returns
    -------
    dict
    """
    rest = dict(statistics)
    core_seconds = rest.pop("seconds", {})
    if not isinstance(core_seconds, dict):
        core_seconds = {"bake": core_seconds}
    scene = {"name": scene_name, **counts, **rest.pop("scene", {})}
    scene.update({name: rest.pop(name) for name in _SCENE_COUNTS if name in rest})
    total = {"total": seconds["total"]} if "total" in seconds else {}
    own = {name: value for name, value in seconds.items() if name not in ("read", "total")}
    read = {name: value for name, value in seconds.items() if name == "read"}
    report = {
        "version": VERSION,
        "radiosity_version": radiosity_version(),
        "blender_version": bpy.app.version_string,
        "scene": scene,
        "settings": settings,
        "seconds": {**read, **core_seconds, **own, **total},
        **dict.fromkeys(_ALWAYS),
        **rest,
        "peak_memory": memory[0],
        "peak_memory_above_start": memory[1],
        "warnings": list(dict.fromkeys(warnings)),
        "skipped": skipped,
    }
    return plain(report)


def plain(value: Any) -> Any:
    """The same value in JSON's own types: NumPy numbers and arrays become plain, what is not finite becomes None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def store_report(scene: bpy.types.Scene, report: dict[str, Any]) -> None:
    """Keep a report with its scene."""
    scene[REPORT_KEY] = json.dumps(report, allow_nan=False)


def read_report(scene: bpy.types.Scene) -> dict[str, Any] | None:
    """The last report of a scene, or None where there is none that this version can read."""
    return _parsed(scene.get(REPORT_KEY))


@lru_cache(maxsize=8)  # panels ask at every redraw
def _parsed(text: Any) -> dict[str, Any] | None:
    if not isinstance(text, str):
        return None
    try:
        report = json.loads(text)
    except ValueError:  # edited by hand
        return None
    return report if isinstance(report, dict) and report.get("version") == VERSION else None


def messages(report: dict[str, Any]) -> list[str]:
    """What a report has to say in words: its warnings, and the skipped objects, those with one reason in one line."""
    names: dict[str, list[str]] = {}
    for entry in report["skipped"]:
        names.setdefault(entry["reason"], []).append(entry["object"])
    return report["warnings"] + [f"Skipped {listed(objects)}: {reason}" for reason, objects in names.items()]


def listed(names: list[str], most: int = 6) -> str:
    """Names in quotes, the first few of many."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(repr(name) for name in names[:most]) + more


def remove_report(scene: bpy.types.Scene) -> bool:
    """Forget the last report; whether there was one."""
    if REPORT_KEY not in scene:
        return False
    del scene[REPORT_KEY]
    return True
