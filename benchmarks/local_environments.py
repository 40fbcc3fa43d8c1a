"""Local environments against the undivided solution: time and memory of a row of furnished rooms joined by doorways.

    python -m benchmarks.local_environments OUTPUT.csv [--rooms 64] [--undivided 16] [--edge 1.0] [--method hemisphere]
        [--accuracy 3e-3] [--lit all] [--workers 1] [--threads 1]

solves rows of 2, 4, 8, ... rooms by ``black_boundary``, ``transparent_boundary`` and, up to a number of rooms, without
division: the form factors of all patches and `gmres`. One line a run goes to OUTPUT.csv:

``seconds``, ``cpu_seconds``
    Of all that it takes from the patches to their radiosity, partition included. CPU seconds count all threads of the
    process, but not those of further processes.
``peak_MB``
    Largest amount that Python and NumPy allocate meanwhile (tracemalloc, which costs some percent of the time); what
    the ray engine holds is not in it.
``time_growth``, ``memory_growth``
    Over that of ideal linear growth from the same strategy's smallest row: 1 where twice the rooms cost twice as much.
``estimated_error``, ``error``
    As the strategy states it, and against the undivided solution, where there is one: area-weighted mean over that of
    the reflected light, in the worst channel. The undivided solution errs as well, by its factors.

Every run has a process of its own. Times depend on what else the machine does: compare those of one run of this
command, and on a busy machine CPU seconds.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from radiosity import core
from radiosity.core.form_factors.matrix import METHODS
from radiosity.core.solvers.transparent_boundary import relative_error

from .solver_scenes import divided, row_of_rooms

STRATEGIES = ("undivided", "black_boundary", "transparent_boundary")

COLUMNS = (
    "rooms",
    "patches",
    "strategy",
    "cells",
    "portals",
    "seconds",
    "cpu_seconds",
    "peak_MB",
    "time_growth",
    "memory_growth",
    "iterations",
    "converged",
    "estimated_error",
    "error",
)


def run(strategy: str, rooms: int, options: argparse.Namespace) -> tuple[dict, np.ndarray]:
    """Numbers of one run, and the radiosity."""
    lit = (0,) if options.lit == "first" else None
    environment = divided(row_of_rooms(rooms, lit=lit), options.edge)
    choices = {"accuracy": options.accuracy, "threads": options.threads}
    tracemalloc.start()
    begin, cpu_begin = time.perf_counter(), time.process_time()
    if strategy == "undivided":
        factors = core.form_factors(environment, options.method, **choices)
        solution = core.solve(environment, factors, "gmres")
    else:
        choices |= {"factor_method": options.method, "workers": options.workers}
        solution = core.solve(environment, method=strategy, **choices)
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    numbers = {
        "rooms": rooms,
        "patches": len(environment),
        "strategy": strategy,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "peak_MB": peak / 1e6,
        "iterations": solution.iterations,
        "converged": solution.converged,
    }
    if strategy != "undivided":
        portals = solution.partition.portals
        numbers["cells"], numbers["portals"] = solution.partition.count, 0 if portals is None else len(portals)
        numbers["estimated_error"] = solution.estimated_error
    return numbers, solution.radiosity


def compare(rooms: int, options: argparse.Namespace) -> list[dict]:
    """Lines of all strategies for one number of rooms."""
    lines, whole = [], None
    for strategy in STRATEGIES:
        if strategy == "undivided" and rooms > options.undivided:
            continue
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            numbers, radiosity = pool.submit(run, strategy, rooms, options).result()
        if strategy == "undivided":
            whole = radiosity
        elif whole is not None:
            environment = divided(row_of_rooms(rooms), options.edge)
            numbers["error"] = relative_error(environment, np.abs(radiosity - whole), whole)
        lines.append(numbers)
    return lines


def add_growth(lines: list[dict]) -> None:
    """Put the growth over linear into each line, from the first line of its strategy."""
    for strategy in STRATEGIES:
        mine = [line for line in lines if line["strategy"] == strategy]
        for line in mine:
            ideal = line["rooms"] / mine[0]["rooms"]
            line["time_growth"] = line["cpu_seconds"] / (ideal * mine[0]["cpu_seconds"])
            line["memory_growth"] = line["peak_MB"] / (ideal * mine[0]["peak_MB"])


def write(path: Path, lines: list[dict]) -> None:
    """Write lines; numbers with four digits, which is more than they hold."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for line in lines:
            writer.writerow({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in line.items()})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.local_environments", description=__doc__.splitlines()[0]
    )
    parser.add_argument("output", type=Path, metavar="OUTPUT.csv")
    parser.add_argument("--rooms", type=int, default=64, help="longest row; the shortest has two")
    parser.add_argument("--undivided", type=int, default=16, help="longest row that is solved without division, too")
    parser.add_argument(
        "--edge", type=float, default=1.0, help="side of a square as large as the largest patch, in meters"
    )
    parser.add_argument("--method", choices=("auto", *METHODS), default="hemisphere", help="of the form factors")
    parser.add_argument("--accuracy", type=float, default=3e-3, help="of the form factors")
    parser.add_argument("--lit", choices=("all", "first"), default="all", help="rooms with a lamp")
    parser.add_argument("--workers", type=int, default=1, help="processes for the cells' factors; 0 takes all cores")
    parser.add_argument("--threads", type=int, default=1, help="threads of the ray engine; 0 takes all cores")
    return parser


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    if options.rooms < 2:
        parser.error("A row has two rooms at least")
    lines, rooms = [], 2
    while rooms <= options.rooms:
        fresh = compare(rooms, options)
        lines += fresh
        add_growth(lines)
        write(options.output, lines)
        for line in fresh:
            run_name = f"{rooms:3} rooms, {line['patches']:5} patches, {line['strategy']}"
            time_cost = f"{line['cpu_seconds']:.2f} CPU s ({line['time_growth']:.2f} x linear)"
            print(
                f"{run_name}: {time_cost}, {line['peak_MB']:.1f} MB ({line['memory_growth']:.2f} x linear)", flush=True
            )
        rooms *= 2


if __name__ == "__main__":
    main()
