"""Our bake beside Cycles' bake of the same vertices, in one process and run: error, time, growth and memory.

    python -m benchmarks.versus_cycles OUTPUT [--cache FOLDER] [--scene cornell_box] [--vertices 20000] ...

Writes `versus_cycles.csv` (one row per bake), `growth.csv` and `summary.json` into OUTPUT and prints them as tables.
The reference is Cycles itself at many samples, two seeds, so that its own noise is known and taken out of every error;
it is kept in the cache folder, since it takes minutes. Times are whole: reading the scene and writing the attribute
included, the best of a few runs for ours and for few samples of Cycles. Nothing here is a test: a busy machine changes
every time.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import bpy
import numpy as np

from . import scenes
from .cycles_bake import Reference, bake_by_cycles, noise_constant, read_vertex_colors, reference_bake
from .geometry import interior_vertices

SCENES = {
    "cornell_box": scenes.cornell_box,
    "furnished_room": scenes.furnished_room,
    "two_rooms": scenes.two_rooms,
    "open_scene_with_sky": scenes.open_scene_with_sky,
}

ATTRIBUTE = "Radiosity"

#: Per vertex: four floats.
ATTRIBUTE_BYTES = 16

#: Vertices of the two bakes whose times and memory are compared.
GROWTH = (20_000, 500_000)


def bake_by_us(obj: bpy.types.Object, accuracy: float, seed: int = 0) -> tuple[np.ndarray, float, dict]:
    """Values (n, 3) per vertex, seconds and report of a bake in the open scene."""
    scenes.select_only(obj)
    start = time.perf_counter()
    bpy.ops.radiosity.bake(
        quality='CUSTOM',
        accuracy=accuracy,
        bake_type='LIGHTING',
        domain='POINT',
        data_type='FLOAT_COLOR',
        attribute_name=ATTRIBUTE,
        seed=seed,
    )
    seconds = time.perf_counter() - start
    return read_vertex_colors(obj, ATTRIBUTE), seconds, json.loads(bpy.context.scene["radiosity_report"])


def cached_reference(obj: bpy.types.Object, name: str, samples: int, cache: Path) -> Reference:
    """The reference of a scene, from the cache folder if it is there for these very vertices."""
    points = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", points)
    path = cache / f"{name}_{len(obj.data.vertices)}_{samples}.npz"
    if path.exists():
        with np.load(path) as stored:
            if np.array_equal(stored["points"], points):
                return Reference.from_halves(stored["first"], stored["second"], samples)
    print(f"Baking the reference: twice {samples} samples at {len(points) // 3} vertices", flush=True)
    reference = reference_bake([obj], samples)
    cache.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part.npz")
    np.savez(partial, points=points, first=reference.halves[0], second=reference.halves[1])
    os.replace(partial, path)
    return reference


def compare(options: argparse.Namespace) -> tuple[list[dict], dict]:
    """Rows of the comparison table, and the summary."""
    obj = SCENES[options.scene](options.vertices)
    interior = interior_vertices(obj)
    everywhere = np.ones_like(interior)
    reference = cached_reference(obj, options.scene, options.reference_samples, options.cache)

    def row(name: str, setting: float, values: np.ndarray, seconds: list[float], extra: str = "") -> dict:
        return {
            "bake": name,
            "setting": setting,
            "seconds": min(seconds),
            "runs": len(seconds),
            "error_interior": reference.error(values, interior),
            "error_all": reference.error(values, everywhere),
            "bias_interior": reference.bias(values, interior),
            "estimated_error": extra,
        }

    rows = []
    for accuracy in options.accuracies:
        seconds = []
        for _ in range(options.repeat):
            values, took, report = bake_by_us(obj, accuracy)
            seconds.append(took)
        rows.append(row("radiosity", accuracy, values, seconds, report["estimated_error"]))
    for samples in options.samples:
        # Many samples average over the machine's moods by themselves.
        bakes = [bake_by_cycles([obj], samples, seed=1) for _ in range(options.repeat if samples <= 4 else 1)]
        rows.append(row("cycles", samples, bakes[0].values, [bake.seconds for bake in bakes]))
    return rows, _summary(options, rows, reference, interior)


def _summary(options: argparse.Namespace, rows: list[dict], reference: Reference, interior: np.ndarray) -> dict:
    """What the promise asks: our time to an error, and Cycles' for 4 samples and for the same error."""
    cycles = [row for row in rows if row["bake"] == "cycles"]
    constant = noise_constant([row["setting"] for row in cycles], [row["error_interior"] for row in cycles])
    seconds = {row["setting"]: row["seconds"] for row in cycles}
    fewest, most = min(seconds), max(seconds)
    per_sample = (seconds[most] - seconds[fewest]) / max(most - fewest, 1)
    good = [row["seconds"] for row in rows if row["bake"] == "radiosity" and row["error_interior"] <= options.target]
    needed = (constant / options.target) ** 2
    return {
        "scene": options.scene,
        "vertices": len(interior),
        "interior_vertices": int(interior.sum()),
        "cores": os.cpu_count(),
        "blender": bpy.app.version_string,
        "reference_samples": 2 * reference.samples,
        "reference_noise_interior": reference.noise(interior),
        "target_error": options.target,
        "radiosity_seconds_to_target": min(good) if good else None,
        "cycles_seconds_for_4_samples": seconds.get(4),
        "cycles_noise_constant": constant,
        "cycles_samples_to_target_by_fit": needed,
        "cycles_seconds_to_target_by_fit": seconds[fewest] + per_sample * (needed - fewest),
    }


def growth(options: argparse.Namespace) -> list[dict]:
    """Time and memory of our bake of the same scene at two sizes, each in a process of its own."""
    rows = []
    for vertices in GROWTH:
        command = [sys.executable, "-m", "benchmarks.versus_cycles", "--measure", options.scene, str(vertices)]
        command += ["--accuracies", str(options.accuracies[0]), "--repeat", str(options.repeat)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"The measurement at {vertices} vertices failed:\n{done.stderr}")
        # Blender talks on standard output too; the measurement is the line of JSON.
        rows.append(json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{"))))
    for row in rows:
        row["times_first"] = row["seconds"] / rows[0]["seconds"]
    return rows


def measure(scene: str, vertices: int, accuracy: float, repeat: int) -> dict:
    """Seconds (best run) and peak memory above Blender's own (first run) of our bake in this process."""
    obj = SCENES[scene](vertices)
    count = len(obj.data.vertices)
    bpy.context.evaluated_depsgraph_get().update()
    # Blender's own: the scene, evaluated, and the attribute that the bake leaves in it.
    before = _start_of_peak() + count * ATTRIBUTE_BYTES
    seconds = [bake_by_us(obj, accuracy)[1]]
    above = _peak_memory() - before
    seconds += [bake_by_us(obj, accuracy)[1] for _ in range(repeat - 1)]
    return {"vertices": count, "seconds": min(seconds), "bytes_above": above, "bytes_per_vertex": above / count}


def _peak_memory() -> int:
    """Largest memory of this process so far, in bytes."""
    import resource  # not on Windows, where the other parts of this module still work

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _start_of_peak() -> int:
    """Memory to which a later `_peak_memory` is compared.

    Linux can start its record anew, from the present size; elsewhere the largest so far has to do, which hides a peak
    below that of building the scene.
    """
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5")
    return _peak_memory()


def _table(rows: list[dict]) -> str:
    def shown(value) -> str:
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    lines = [list(rows[0])] + [[shown(value) for value in row.values()] for row in rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)


def _write_csv(path: Path, rows: list[dict]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _numbers(kind):
    return lambda text: [kind(each) for each in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.versus_cycles", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, nargs="?", help="folder for the tables, made if missing")
    parser.add_argument("--cache", type=Path, help="folder that keeps references; by default OUTPUT/references")
    parser.add_argument("--scene", choices=SCENES, default="cornell_box")
    parser.add_argument("--vertices", type=int, default=20_000)
    parser.add_argument("--accuracies", type=_numbers(float), default=[0.03, 0.02, 0.01], help="ours, 0.03,0.02,...")
    parser.add_argument("--samples", type=_numbers(int), default=[4, 16, 64], help="Cycles' per vertex, 4,16,...")
    parser.add_argument("--reference-samples", type=int, default=1024, help="of each half of the reference")
    parser.add_argument("--target", type=float, default=0.02, help="interior error whose time is asked for")
    parser.add_argument("--repeat", type=int, default=3, help="runs whose best time counts")
    parser.add_argument("--no-growth", action="store_true", help="leave out the 20,000 and 500,000 vertices")
    parser.add_argument("--measure", nargs=2, metavar=("SCENE", "VERTICES"), help=argparse.SUPPRESS)
    return parser


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    if options.output is None and not options.measure:
        parser.error("name a folder for the tables")
    import radiosity

    radiosity.register()
    try:
        if options.measure:
            scene, vertices = options.measure
            print(json.dumps(measure(scene, int(vertices), options.accuracies[0], options.repeat)))
        else:
            _run(options)
    finally:
        # With the bpy module, classes that are still registered hang or crash Python's own exit.
        radiosity.unregister()


def _run(options: argparse.Namespace) -> None:
    options.output.mkdir(parents=True, exist_ok=True)
    options.cache = options.cache or options.output / "references"
    rows, summary = compare(options)
    _write_csv(options.output / "versus_cycles.csv", rows)
    print(_table(rows), flush=True)
    if not options.no_growth:
        sizes = growth(options)
        _write_csv(options.output / "growth.csv", sizes)
        print(_table(sizes))
        summary["growth_in_time"] = sizes[-1]["times_first"]
        summary["bytes_per_vertex"] = sizes[-1]["bytes_per_vertex"]
    (options.output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(summary, indent=2))


if __name__ == "__main__":
    main()
