"""Form factors beside pyviewfactor's, on the same meshes, in turns: pairs per CPU second, and errors.

    python -m venv PVF
    PVF/bin/python -m pip install pyviewfactor==1.1.0
    python -m benchmarks.versus_pyviewfactor OUTPUT --python PVF/bin/python [--meshes touching_plates,...]
        [--patches 1000] [--occluded-patches 200] [--repeat 3] [--threads 0]

pyviewfactor comes with Numba, SciPy and VTK: it lives in an environment of its own, ``PVF`` above, and in a process of
its own (`pyviewfactor_worker`), which has compiled everything before it is measured. Writes `versus_pyviewfactor.csv`,
one line a run, and the same as a table in `versus_pyviewfactor.md`.

Meshes are of quadrilaterals and of triangles. Where nothing can block, the reference is the contour integral, exact to
1e-10; where something can, `auto` at `REFERENCE_ACCURACY`, which clips exactly. Pairs are those that exchange light by
the reference: others cost all programs next to nothing. ``contact_error`` is the largest error of a factor between
patches that touch, relative to it, where it is 1e-3 or more. ``centers`` is the plain formula from center to center,
of which fast programs make all factors: what its error is worth without occlusion. Each method's runs take turns with
pyviewfactor's, and the least CPU time of `--repeat` counts, all threads together; ours includes the repair of both
identities, which theirs does without.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from radiosity import core

from .form_factor_scenes import SCENES, box, divided, furniture, rectangle

WORKER = Path(__file__).with_name("pyviewfactor_worker.py")

#: Accuracy of references with occlusion.
REFERENCE_ACCURACY = 1e-4

#: Distance of corners, in sizes of the scene, within which patches touch.
TOUCHING = 1e-9

#: Factors from which the relative error of touching patches is told.
LEAST_CONTACT = 1e-3

#: Ours: name, method, visibility and further choices, without and with occlusion.
UNOCCLUDED = (
    ("contour_integral, fast", "contour_integral", "none", {"fast": True}),
    ("contour_integral", "contour_integral", "none", {}),
    ("auto", "auto", "auto", {}),
)
OCCLUDED = (
    ("contour_integral, embree, fast", "contour_integral", "embree", {"fast": True, "accuracy": 1e-2}),
    ("hemisphere", "hemisphere", "embree", {"accuracy": 1e-2}),
    ("auto at 0.01", "auto", "auto", {"accuracy": 1e-2}),
    ("auto", "auto", "auto", {}),
)

COLUMNS = (
    "mesh",
    "patches",
    "pairs",
    "program",
    "seconds",
    "cpu_seconds",
    "pairs_per_cpu_second",
    "max_error",
    "rms_error",
    "contact_error",
    "row_sum_error",
)


@dataclass(frozen=True)
class Mesh:
    """Polygons, and whether they may stand between each other."""

    name: str
    polygons: list[np.ndarray]
    occluded: bool


def touching_plates() -> list[np.ndarray]:
    """Two unit squares at a right angle with an edge in common."""
    floor = rectangle([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    return floor + rectangle([(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)])


def empty_room() -> list[np.ndarray]:
    return box((0, 0, 0), (5, 4, 2.6), inward=True)


def occluded_plates() -> list[np.ndarray]:
    return list(SCENES["occluded_plates"]().environment.polygons)


def cornell_box() -> list[np.ndarray]:
    return list(SCENES["cornell_box"]().environment.polygons)


def furnished_room() -> list[np.ndarray]:
    return empty_room() + furniture()


#: Surfaces by name, and whether they occlude each other.
MESHES: dict[str, tuple[Callable[[], list[np.ndarray]], bool]] = {
    "touching_plates": (touching_plates, False),
    "empty_room": (empty_room, False),
    "occluded_plates": (occluded_plates, True),
    "cornell_box": (cornell_box, True),
    "furnished_room": (furnished_room, True),
}


def meshes(names: list[str], patches: int, occluded_patches: int) -> list[Mesh]:
    """Meshes of about so many patches, of quadrilaterals and of triangles each."""
    found = []
    for name in names:
        make, occluded = MESHES[name]
        surfaces = make()
        wanted = occluded_patches if occluded else patches
        for kind in ("quads", "triangles"):
            triangles = kind == "triangles"
            length = np.sqrt(core.Environment.from_polygons(surfaces).areas.sum() * (1 + triangles) / wanted)
            found.append(Mesh(f"{name}, {kind}", divided(surfaces, float(length), triangles), occluded))
    return found


class Theirs:
    """pyviewfactor in a process of another Python."""

    def __init__(self, python: str, folder: Path):
        self.folder = folder
        self.process = subprocess.Popen(
            [python, str(WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
        )
        self.version = self._answer()["version"]

    def _answer(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            raise ChildProcessError("pyviewfactor's process ended; what it said is above. Give --python PVF/bin/python")
        return json.loads(line)

    def __call__(self, mesh: Mesh) -> tuple[np.ndarray, float, float]:
        """Factors (n, n), seconds, and CPU seconds of one run."""
        path, result = self.folder / "mesh.npz", self.folder / "result.npy"
        np.savez(path, corners=np.concatenate(mesh.polygons), counts=[len(polygon) for polygon in mesh.polygons])
        self.process.stdin.write(f"{path}\t{result}\t{int(mesh.occluded)}\n")
        self.process.stdin.flush()
        took = self._answer()
        return np.load(result), took["seconds"], took["cpu_seconds"]

    def close(self) -> None:
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait()


def ours(method: str, visibility: str, choices: dict, threads: int) -> Callable[[Mesh], tuple]:
    """What makes one run of ours: from polygons to factors, as theirs from a mesh."""

    def run(mesh: Mesh) -> tuple[np.ndarray, float, float]:
        environment = core.Environment.from_polygons(mesh.polygons)
        begin, cpu_begin = time.perf_counter(), time.process_time()
        matrix = core.form_factors(environment, method, visibility, threads=threads, **choices).matrix
        return matrix, time.perf_counter() - begin, time.process_time() - cpu_begin

    return run


def center_to_center(mesh: Mesh) -> tuple[np.ndarray, float, float]:
    """The plain formula between centers of area: ``cos cos A / pi r^2``."""
    environment = core.Environment.from_polygons(mesh.polygons)
    begin, cpu_begin = time.perf_counter(), time.process_time()
    places, normals = environment.centroids, environment.normals
    own = np.einsum("ni,ni->n", normals, places)
    heights = normals @ places.T - own[:, None]  # of the column's center above the row's plane
    squares = sum(np.square(places[:, axis] - places[:, axis][:, None]) for axis in range(3))
    squares[squares == 0] = np.inf
    matrix = np.maximum(heights, 0) * np.maximum(heights.T, 0) * environment.areas / (np.pi * squares * squares)
    return matrix, time.perf_counter() - begin, time.process_time() - cpu_begin


def touching_pairs(polygons: list[np.ndarray]) -> np.ndarray:
    """(n, n) bool: patches with a corner in the same place."""
    corners = np.concatenate(polygons)
    owners = np.repeat(np.arange(len(polygons)), [len(polygon) for polygon in polygons])
    places = np.unique(np.round(corners / (TOUCHING * np.ptp(corners, axis=0).max())), axis=0, return_inverse=True)[1]
    meets = np.zeros((len(polygons), places.max() + 1), dtype=np.float32)
    meets[owners, places.reshape(-1)] = 1
    return (meets @ meets.T > 0) & ~np.eye(len(polygons), dtype=bool)


def errors(found: np.ndarray, exact: np.ndarray, touching: np.ndarray) -> dict:
    differences = np.abs(found - exact)
    contacts = touching & (exact >= LEAST_CONTACT)
    return {
        "max_error": differences.max(),
        "rms_error": np.sqrt(np.square(differences).mean()),
        "contact_error": (differences[contacts] / exact[contacts]).max(initial=0),
        "row_sum_error": np.abs(found.sum(axis=1) - exact.sum(axis=1)).max(),
    }


def compare(mesh: Mesh, theirs: Theirs, repeat: int, threads: int) -> list[dict]:
    """Lines of one mesh: ours and theirs take turns."""
    environment = core.Environment.from_polygons(mesh.polygons)
    if mesh.occluded:
        exact = core.form_factors(environment, accuracy=REFERENCE_ACCURACY, threads=threads).matrix
    else:
        exact = core.form_factors(environment, "contour_integral", "none").matrix
    touching, pairs = touching_pairs(mesh.polygons), int((exact > 0).sum()) // 2
    programs = {f"pyviewfactor {theirs.version}": theirs}
    for name, method, visibility, choices in OCCLUDED if mesh.occluded else UNOCCLUDED:
        programs[name] = ours(method, visibility, choices, threads)
    if not mesh.occluded:
        programs["centers"] = center_to_center
    best = {}
    for _ in range(repeat):
        for name, program in programs.items():
            matrix, seconds, cpu_seconds = program(mesh)
            if name not in best or cpu_seconds < best[name]["cpu_seconds"]:
                best[name] = {"seconds": seconds, "cpu_seconds": cpu_seconds, **errors(matrix, exact, touching)}
    return [
        {
            "mesh": mesh.name,
            "patches": len(environment),
            "pairs": pairs,
            "program": name,
            **numbers,
            "pairs_per_cpu_second": pairs / max(numbers["cpu_seconds"], 1e-6),
        }
        for name, numbers in best.items()
    ]


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def write_tables(folder: Path, lines: list[dict]) -> None:
    """Write all lines as CSV and as Markdown."""
    with (folder / "versus_pyviewfactor.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows({key: _text(line[key]) for key in COLUMNS} for line in lines)
    rows = [COLUMNS, ["---"] * len(COLUMNS), *([_text(line[key]) for key in COLUMNS] for line in lines)]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    (folder / "versus_pyviewfactor.md").write_text(f"{table}\n", encoding="utf-8")
    print(table)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.versus_pyviewfactor", description=__doc__.splitlines()[0]
    )
    parser.add_argument("output", type=Path, metavar="OUTPUT", help="folder for the tables")
    parser.add_argument("--python", required=True, help="the Python of the environment that has pyviewfactor")
    parser.add_argument("--meshes", default=",".join(MESHES), help=f"of {', '.join(MESHES)}")
    parser.add_argument("--patches", type=int, default=1000, help="about so many where nothing blocks")
    parser.add_argument("--occluded-patches", type=int, default=200, help="about so many where something may")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each, of which the best counts")
    parser.add_argument("--threads", type=int, default=0, help="of the ray engine; 0 takes all cores")
    return parser


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    names = options.meshes.split(",")
    for name in names:
        if name not in MESHES:
            parser.error(f"Unknown mesh {name!r}: choose {', '.join(MESHES)}")
    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        theirs, lines = Theirs(options.python, Path(folder)), []
        try:
            for mesh in meshes(names, options.patches, options.occluded_patches):
                lines += compare(mesh, theirs, options.repeat, options.threads)
                print(f"{mesh.name}: {len(mesh.polygons)} patches", flush=True)
        finally:
            theirs.close()
    write_tables(options.output, lines)


if __name__ == "__main__":
    sys.exit(main())
