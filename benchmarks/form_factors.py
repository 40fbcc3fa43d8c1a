"""All form-factor methods with all visibilities on six scenes: error against time, rays and memory.

    python -m benchmarks.form_factors OUTPUT [--scenes facing_plates,...] [--methods hemicube,...] [--quick]
        [--scene-file ROOM.obj] [--patches 40] [--limit 3] [--threads 0]

writes to the folder OUTPUT:

``runs.csv``
    One line a run: a scene, a method, a visibility, its options and the accuracy asked for. Errors are those of the
    result as a user gets it, both identities repaired, against the scene's reference (`form_factor_scenes`); closure
    and reciprocity are those before the repair. A row's sum may be wrong where closure holds by construction, so it is
    compared as well. Pairs that are refused, and runs left out, say why in the column ``status``.
``best.csv``
    For each scene and error the fastest run that reached it.
``slopes.csv``, ``slopes.png``
    Error of each sampling technique against its resolution, and how fast it falls (`form_factor_slopes`).
``SCENE.png``
    Error against time, if matplotlib is there: ``python -m pip install matplotlib``.

Every scene is measured in a process of its own. What takes less than `REPEATED` seconds is run three times, and the
least time counts. Memory is the peak of what Python and NumPy allocate (tracemalloc) in a further run, since tracing
costs time; what the ray engine holds is not in it. A run above the time limit is ended, and the series' finer runs are
left out, as they are after one that came near it. Times depend on what else the machine does: compare those of one run
of this command, and on a busy machine CPU seconds, which count all threads.
"""

from __future__ import annotations

import argparse
import csv
import json
import logging
import multiprocessing
import sys
import time
import tracemalloc
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from radiosity import core
from radiosity.core.errors import RadiosityError, SettingsError
from radiosity.core.form_factors.matrix import METHODS, find_method

from . import form_factor_plots, form_factor_slopes
from .form_factor_scenes import SCENES, Scene, scene_from_file

ACCURACIES = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
QUICK_ACCURACIES = (1e-2, 1e-3)

#: Accuracies of the options.
OPTION_ACCURACIES = (1e-2, 3e-3, 1e-3)

#: Accuracy beside an option that sets the effort by itself.
PLAIN_ACCURACY = 1e-3

#: Seconds below which a run is repeated, and how often.
REPEATED, REPETITIONS = 0.2, 3

#: Time limits that the first run of a series may take, so that slow methods show at least one.
FIRST_STEP = 2

#: CPU seconds, as part of the time limit, after which finer steps are left out: each takes about three times the one
#: before. CPU seconds, so that what else the machine does decides less.
LAST_STEP = 1 / 3

#: Errors for which the fastest run is named.
GOALS = (1e-2, 1e-3, 1e-4, 1e-6)

#: Options beside the defaults: method, options that stay, and the option that is stepped through with its values; None
#: steps through some accuracies.
OPTIONS = (
    ("hemisphere", {"sampling": "random"}, None, ()),
    ("hemicube", {"resolution": 16}, None, ()),
    ("hemicube", {"resolution": 64}, None, ()),
    ("single_plane", {"resolution": 24}, None, ()),
    ("single_plane", {"resolution": 96}, None, ()),
    ("point_to_point", {}, "cells", (1, 2, 4, 8, 16)),
    ("disk", {"sampling": "uniform"}, "samples", (1, 4, 16)),
    ("disk", {"sampling": "jittered"}, "samples", (1, 4, 16)),
    ("contour_integral", {"fast": True}, None, ()),
)

COLUMNS = (
    "scene",
    "patches",
    "method",
    "visibility",
    "options",
    "accuracy",
    "status",
    "max_error",
    "rms_error",
    "row_sum_error",
    "estimated_error",
    "closure_raw",
    "reciprocity_raw",
    "seconds",
    "cpu_seconds",
    "rays",
    "peak_MB",
    "reference",
    "reference_error",
)


@dataclass(frozen=True)
class Series:
    """One method with one visibility, from coarse to fine: (accuracy, options) of each step."""

    method: str
    visibility: str
    label: str
    steps: tuple[tuple[float, dict], ...]


@dataclass
class Bench:
    """A process that measures on one scene, started anew after a run that had to be ended."""

    scene: Scene
    threads: int
    process: multiprocessing.Process | None = None
    connection: object = field(default=None, repr=False)

    def measure(self, series: Series, accuracy: float, options: dict, limit: float) -> dict:
        """Numbers of a run, or only its ``status``; the traced run has the same limit, or goes without a result."""
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.connection, theirs = context.Pipe()
            self.process = context.Process(target=serve, args=(theirs, self.scene, self.threads), daemon=True)
            self.process.start()
            theirs.close()
            self.connection.recv()
        self.connection.send((series.method, series.visibility, accuracy, options))
        # The first run may be followed by two repetitions, which are short.
        if not self.connection.poll(limit + REPETITIONS * REPEATED):
            self.end()
            return {"status": f"ended after {limit:g} s"}
        numbers = self.connection.recv()
        if numbers["status"] != "done":
            return numbers
        if self.connection.poll(limit):
            numbers["peak_MB"] = self.connection.recv()
        else:
            self.end()
        return numbers

    def end(self) -> None:
        """Stop the process."""
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None


def serve(connection, scene: Scene, threads: int) -> None:
    """Answer runs on a scene: numbers first, then the peak of memory of the same run, traced."""
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)  # an accuracy that was not reached shows in ``estimated_error``
    # What Python and NumPy load at first use is no method's cost.
    core.form_factors(SCENES["facing_plates"]().environment, "hemisphere", accuracy=0.1)
    connection.send("ready")
    while True:
        method, visibility, accuracy, options = connection.recv()
        choices = {"accuracy": accuracy, "threads": threads, **options}
        try:
            numbers = timed_run(scene, method, visibility, choices)
        except RadiosityError as error:
            connection.send({"status": f"refused: {error}"})
            continue
        connection.send(numbers)
        tracemalloc.start()
        core.form_factors(scene.environment, method, visibility, **choices)
        connection.send(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()


def timed_run(scene: Scene, method: str, visibility: str, choices: dict) -> dict:
    """Errors and costs of one method on a scene."""
    seconds, cpu_seconds = np.inf, np.inf
    for _ in range(REPETITIONS):
        begin, cpu_begin = time.perf_counter(), time.process_time()
        result = core.form_factors(scene.environment, method, visibility, **choices)
        seconds = min(seconds, time.perf_counter() - begin)
        cpu_seconds = min(cpu_seconds, time.process_time() - cpu_begin)
        if seconds > REPEATED:
            break
    differences = scene.surface_factors(result.matrix) - scene.factors
    known = ~np.isnan(differences)
    whole_rows = known.all(axis=1)
    sums = differences[whole_rows].sum(axis=1)
    return {
        "status": "done",
        "max_error": np.abs(differences[known]).max(),
        "rms_error": np.sqrt(np.square(differences[known]).mean()),
        "row_sum_error": np.abs(sums).max() if whole_rows.any() else "",
        "estimated_error": result.estimated_error,
        "closure_raw": result.raw_closure_error,
        "reciprocity_raw": result.raw_reciprocity_error,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "rays": result.rays,
    }


def all_series(methods: list[str], accuracies: tuple[float, ...]) -> list[Series]:
    """Every method with every visibility it takes at its defaults, then the options with its first visibility."""
    series = []
    for method in methods:
        steps = tuple((accuracy, {}) for accuracy in accuracies)
        series += [Series(method, visibility, "", steps) for visibility in METHODS[method].visibilities]
    for method, fixed, stepped, values in OPTIONS:
        if method not in methods:
            continue
        if stepped is None:
            steps = tuple((accuracy, fixed) for accuracy in OPTION_ACCURACIES if accuracy in accuracies)
        else:
            steps = tuple((PLAIN_ACCURACY, {**fixed, stepped: value}) for value in values)
        label = " ".join(
            [*(f"{name} {value}" for name, value in fixed.items()), *([f"by {stepped}"] if stepped else [])]
        )
        series.append(Series(method, METHODS[method].visibilities[0], label, steps))
    return series


def refusals(methods: list[str]) -> list[dict]:
    """A line for each pair of method and visibility that exists nowhere, with the reason."""
    names = list(dict.fromkeys(visibility for method in METHODS.values() for visibility in method.visibilities))
    lines = []
    for method in methods:
        for visibility in names:
            try:
                find_method(method, visibility, {})
            except SettingsError as error:
                lines.append(
                    {"scene": "any", "method": method, "visibility": visibility, "status": f"refused: {error}"}
                )
    return lines


def run_scene(scene: Scene, series: list[Series], limit: float, threads: int) -> list[dict]:
    """Lines of all series on one scene."""
    bench, lines = Bench(scene, threads), []
    try:
        for one in series:
            stopped = ""
            for step, (accuracy, options) in enumerate(one.steps):
                allowed = limit if step else FIRST_STEP * limit
                numbers = {"status": stopped} if stopped else bench.measure(one, accuracy, options, allowed)
                if numbers["status"].startswith("ended"):
                    stopped = "left out: a coarser step took too long"
                elif numbers.get("cpu_seconds", 0) > LAST_STEP * limit:
                    stopped = (
                        f"left out: the last step took {numbers['cpu_seconds']:.1f} CPU seconds of {limit:g} allowed"
                    )
                line = {
                    "scene": scene.name,
                    "patches": len(scene.environment),
                    "method": one.method,
                    "visibility": one.visibility,
                    "options": json.dumps(options) if options else "",
                    "accuracy": accuracy,
                    "reference": scene.source,
                    "reference_error": scene.uncertainty,
                    "label": one.label,
                    "occluded": scene.occluded,
                }
                lines.append(line | numbers)
                if numbers["status"].startswith("refused"):
                    break
    finally:
        bench.end()
    return lines


def fastest(lines: list[dict]) -> list[dict]:
    """For each scene and goal, the run that reached it in the least CPU time."""
    best = []
    for scene in dict.fromkeys(line["scene"] for line in lines):
        for goal in GOALS:
            runs = [line for line in lines if line["scene"] == scene and line.get("max_error", np.inf) <= goal]
            if runs and max(float(line["reference_error"]) for line in runs) < goal:
                best.append({"goal": goal, **min(runs, key=lambda line: line["cpu_seconds"])})
    return best


def write_csv(path: Path, columns: tuple[str, ...], lines: list[dict]) -> None:
    """Write lines; numbers with four digits, which is more than they hold."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        for line in lines:
            writer.writerow({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in line.items()})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.form_factors", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, metavar="OUTPUT", help="folder for tables and pictures")
    parser.add_argument("--scenes", default=",".join(SCENES), help=f"of {', '.join(SCENES)}")
    parser.add_argument("--scene-file", type=Path, help="an OBJ file, as one scene more")
    parser.add_argument("--patches", type=int, default=40, help="largest polygons taken from the file")
    parser.add_argument("--methods", default=",".join(METHODS), help=f"of {', '.join(METHODS)}")
    parser.add_argument("--quick", action="store_true", help="two accuracies instead of six")
    parser.add_argument(
        "--limit", type=float, default=3.0, help="seconds that a run may take; the first of a series twice that"
    )
    parser.add_argument("--threads", type=int, default=0, help="0 takes all cores")
    return parser


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    names = [name for name in options.scenes.split(",") if name]
    methods = [name for name in options.methods.split(",") if name]
    for name, known in [*((name, SCENES) for name in names), *((name, METHODS) for name in methods)]:
        if name not in known:
            parser.error(f"Unknown name {name!r}: choose {', '.join(known)}")
    makers = [SCENES[name] for name in names]
    if options.scene_file:
        makers.append(lambda: scene_from_file(options.scene_file, options.patches))
    series = all_series(methods, QUICK_ACCURACIES if options.quick else ACCURACIES)
    options.output.mkdir(parents=True, exist_ok=True)
    slopes = form_factor_slopes.measure(methods)
    write_csv(options.output / "slopes.csv", form_factor_slopes.COLUMNS, slopes)
    form_factor_plots.draw_slopes(options.output / "slopes.png", slopes)
    for line in {line["technique"]: line for line in slopes}.values():
        print(f"{line['technique']:30} error falls by {line['unit']} to the power {line['slope']:.2f}")
    lines = refusals(methods)
    for make in makers:
        begin = time.perf_counter()
        scene = make()
        lines += run_scene(scene, series, options.limit, options.threads)
        write_csv(options.output / "runs.csv", COLUMNS, lines)
        form_factor_plots.draw(options.output / f"{scene.name}.png", [x for x in lines if x["scene"] == scene.name])
        print(f"{scene.name}: {len(scene.environment)} patches, {time.perf_counter() - begin:.0f} s", flush=True)
    best = fastest(lines)
    write_csv(options.output / "best.csv", ("goal", *COLUMNS), best)
    for run in best:
        name = f"{run['method']} {run['visibility']} {run['options']}"
        print(
            f"{run['scene']:16} {run['goal']:g}: {name}, accuracy {run['accuracy']:g}, {run['cpu_seconds']:.2g} CPU s"
        )


if __name__ == "__main__":
    sys.exit(main())
