"""Levels of discretization (survey figure 18, ccl.9): error of radiosities by number of patches and by sampling.

    python -m pip install matplotlib      # only for the pictures
    python -m benchmarks.discretization OUTPUT [--scenes facing_plates,...] [--levels 1,2,4,8] [--finest 16]
        [--most-patches 2200] [--seed 0] [--threads 0]

Scenes of `tests/reference/solutions.json`, their surfaces divided into 1, 4, 16, ... patches each. Form factors come
from hemicubes of several resolutions, four to a patch, from hemispheres of several numbers of rays, and from `auto` at
`FACTOR_ACCURACY`, which stands for no sampling at all. Reference is the solution on the finest division with such
factors. Errors are differences of radiosity on the finest patches, each of which lies in one of every level: RMS by
area and over channels, relative to the RMS of the reference's reflected light.

``discretization_error``
    What remains with the best factors: radiosity that is even over a patch, where light is not.
``sampling_error``
    Between sampled and best factors on the same patches.
``error``
    Both together, against the reference.

Writes `discretization.csv`, one line a run, and `SCENE.png` if matplotlib is there: error by patches, a line for each
sampling, and the same by CPU seconds. The reference errs by itself as its patches are coarse: errors of its own size
mean nothing, so keep `--finest` at twice the finest level or more.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from radiosity import core
from radiosity.core.form_factors.hemicube import hemicube_rows
from radiosity.core.form_factors.hemisphere import REPETITIONS, RowCaster
from radiosity.core.form_factors.identities import repair

from .form_factor_plots import can_draw
from .form_factor_scenes import REFERENCE_DATA, divided

#: Scenes: cases of the published solutions, all with known radiosities of the undivided surfaces.
SCENES = {"facing_plates": "openpair-1", "box_room": "box543", "cornell_box": "cornell-rgb"}

#: Pixels along the side of a hemicube's top face, and rays of a patch.
RESOLUTIONS = (8, 16, 32, 64, 128)
RAYS = (64, 256, 1024, 4096, 16384)

#: Accuracy of the factors that count as not sampled.
FACTOR_ACCURACY = 1e-3

#: An accuracy that any first round of sampling meets, so that none follows.
ANY_ACCURACY = 0.999

COLUMNS = (
    "scene",
    "patches",
    "divisions",
    "method",
    "resolution",
    "error",
    "discretization_error",
    "sampling_error",
    "cpu_seconds",
)


@dataclass(frozen=True)
class LitScene:
    """Surfaces, one polygon or several each, as they are lit in the published case."""

    name: str
    polygons: list[np.ndarray]
    owners: np.ndarray  # (p,) int, surface of each polygon
    reflectance: np.ndarray  # (s, 3)
    emission: np.ndarray  # (s, 3)

    @classmethod
    def published(cls, name: str, case_id: str) -> LitScene:
        """Scene of a case of the reference data."""
        solutions, shapes = (
            {case["id"]: case for case in json.loads(path.read_text(encoding="utf-8"))["cases"]}
            for path in (REFERENCE_DATA.with_name("solutions.json"), REFERENCE_DATA)
        )
        case = solutions[case_id]
        where = case["geometry"]
        surfaces = shapes[where["form_factor_case"]]["surfaces"] if "form_factor_case" in where else where["surfaces"]
        names = [surface["name"] for surface in surfaces]
        return cls(
            name,
            [np.array(polygon, dtype=float) for surface in surfaces for polygon in surface["polygons"]],
            np.repeat(np.arange(len(surfaces)), [len(surface["polygons"]) for surface in surfaces]),
            *(_channels(table, names) for table in (case["reflectance"], case["emission"])),
        )

    def divided(self, divisions: int) -> tuple[core.Environment, np.ndarray]:
        """Patches of a level, and the surface of each."""
        parts = [divided([polygon], divisions) for polygon in self.polygons]
        owners = np.repeat(self.owners, [len(cells) for cells in parts])
        polygons = [cell for cells in parts for cell in cells]
        return core.Environment.from_polygons(polygons, self.reflectance[owners], self.emission[owners]), owners


def _channels(table, names):
    """Values (s, 3) by name, one channel or three."""
    values = np.array([np.atleast_1d(table[name]) for name in names], dtype=float)
    return np.broadcast_to(values, (len(names), 3)).copy()


def exact_factors(environment: core.Environment, seed: int, threads: int) -> np.ndarray:
    return core.form_factors(environment, accuracy=FACTOR_ACCURACY, seed=seed, threads=threads).matrix


def hemicube_factors(environment: core.Environment, resolution: int, seed: int, threads: int) -> np.ndarray:
    """The first round of the method and no more: its cubes are of one resolution."""
    rows = hemicube_rows(environment, "zbuffer", ANY_ACCURACY, seed, threads, resolution)
    return repair(rows.matrix, environment.areas, _is_closed(rows.escaped, environment), rows.samples)


def hemisphere_factors(environment: core.Environment, resolution: int, seed: int, threads: int) -> np.ndarray:
    caster, count = RowCaster(environment, threads), len(environment)
    matrix, escaped = np.zeros((count, count)), np.zeros(count)
    # Rows at once as the method itself takes them: some 10 MB of counts.
    for part in np.array_split(np.arange(count), max(1, count * resolution // 2**20)):
        shares, _, _ = caster.rows(part, resolution // REPETITIONS, (seed, 0))
        matrix[part], escaped[part] = shares[:, :-1], shares[:, -1]
    return repair(matrix, environment.areas, _is_closed(escaped, environment))


def _is_closed(escaped, environment):
    """Whether no patch loses light, but for rounding: then rows are made to sum to 1, as `form_factors` does."""
    return bool(escaped[environment.areas > 0].max() < 1e-9)


#: What samples, by name, and its resolutions.
SAMPLINGS: dict[str, tuple[Callable[..., np.ndarray], tuple[int, ...]]] = {
    "hemicube": (hemicube_factors, RESOLUTIONS),
    "hemisphere": (hemisphere_factors, RAYS),
}


def descends(scene: LitScene, divisions: int, finest: int) -> np.ndarray:
    """(f,) patch of a level that each patch of the finest lies in."""
    fine, _ = scene.divided(finest)
    starts = np.concatenate(([0], np.cumsum([divisions**2] * len(scene.polygons))))
    places = fine.centroids.reshape(len(scene.polygons), finest**2, 3)
    parents = []
    for row, polygon in enumerate(scene.polygons):
        cells = core.Environment.from_polygons(divided([polygon], divisions))
        # A point lies in the cell whose edges all have it on their inner side: the largest of the least distances.
        corners = np.array(cells.polygons)
        edges = np.roll(corners, -1, axis=1) - corners
        inward = np.cross(cells.normals[:, None], edges)
        inward /= np.linalg.norm(inward, axis=2, keepdims=True)
        heights = np.einsum("cki,ckfi->ckf", inward, places[row] - corners[:, :, None])
        parents.append(starts[row] + heights.min(axis=1).argmax(axis=0))
    return np.concatenate(parents)


def run_scene(scene: LitScene, levels: tuple[int, ...], finest: int, seed: int, threads: int) -> list[dict]:
    """Lines of all levels and samplings of a scene."""
    fine, _ = scene.divided(finest)
    reference = core.solve(fine, exact_factors(fine, seed, threads)).radiosity
    reflected = relative_to(reference - fine.emission, fine.areas)
    lines = []
    for divisions in levels:
        environment, _ = scene.divided(divisions)
        parents = descends(scene, divisions, finest)
        begin = time.process_time()
        best = core.solve(environment, exact_factors(environment, seed, threads)).radiosity
        runs = [("auto", "", best, time.process_time() - begin)]
        for name, (factors, resolutions) in SAMPLINGS.items():
            for resolution in resolutions:
                begin = time.process_time()
                matrix = factors(environment, resolution, seed, threads)
                runs.append((name, resolution, core.solve(environment, matrix).radiosity, time.process_time() - begin))
        floor = relative_to(best[parents] - reference, fine.areas) / reflected
        for name, resolution, found, seconds in runs:
            lines.append(
                {
                    "scene": scene.name,
                    "patches": len(environment),
                    "divisions": divisions,
                    "method": name,
                    "resolution": resolution,
                    "error": relative_to(found[parents] - reference, fine.areas) / reflected,
                    "discretization_error": floor,
                    "sampling_error": relative_to(found - best, environment.areas) / reflected,
                    "cpu_seconds": seconds,
                }
            )
    return lines


def relative_to(values: np.ndarray, areas: np.ndarray) -> float:
    """RMS by area of values (n, 3)."""
    return float(np.sqrt(np.average(np.square(values).mean(axis=1), weights=areas)))


def draw(path: Path, lines: list[dict]) -> None:
    """Draw the runs of one scene, or say how to get what draws them."""
    if not can_draw(path):
        return
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter

    figure, panels = pyplot.subplots(1, 2, figsize=(11, 5.4), sharey=True, layout="constrained")
    kinds = list(dict.fromkeys((line["method"], line["resolution"]) for line in lines))
    for method, resolution in kinds:
        runs = [line for line in lines if (line["method"], line["resolution"]) == (method, resolution)]
        among = [kind for kind in kinds if kind[0] == method]
        shade = 0.35 + 0.6 * (among.index((method, resolution)) + 1) / len(among)
        color = "black" if method == "auto" else pyplot.get_cmap({"hemicube": "Oranges"}.get(method, "Blues"))(shade)
        unit = {"hemicube": "pixels", "hemisphere": "rays"}.get(method, "")
        for panel, key in zip(panels, ("patches", "cpu_seconds"), strict=True):
            panel.plot(
                [run[key] for run in runs],
                [run["error"] for run in runs],
                color=color,
                marker="o",
                markersize=4,
                label=f"{method} {resolution} {unit}".strip(),
            )
    for panel, label in zip(panels, ("patches", "CPU seconds"), strict=True):
        panel.set(xscale="log", yscale="log", xlabel=label)
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.grid(color="0.9")
    panels[0].set_ylabel("RMS error of reflected light")
    panels[1].legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    figure.suptitle(f"{lines[0]['scene']}: patches against samples of a patch; black: factors not sampled")
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discretization", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, metavar="OUTPUT", help="folder for table and pictures")
    parser.add_argument("--scenes", default=",".join(SCENES), help=f"of {', '.join(SCENES)}")
    parser.add_argument("--levels", default="1,2,4,8", help="divisions of a side")
    parser.add_argument("--finest", type=int, default=16, help="divisions of the reference, a multiple of each level")
    parser.add_argument(
        "--most-patches", type=int, default=2200, help="levels and references of more patches are made coarser"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0, help="of the ray engine; 0 takes all cores")
    return parser


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    levels = tuple(int(level) for level in options.levels.split(","))
    names = options.scenes.split(",")
    for name in names:
        if name not in SCENES:
            parser.error(f"Unknown scene {name!r}: choose {', '.join(SCENES)}")
    if any(options.finest % level or options.finest <= level for level in levels):
        parser.error(f"--finest {options.finest} must be a multiple of every level of {options.levels}")
    options.output.mkdir(parents=True, exist_ok=True)
    lines = []
    for name in names:
        scene, finest = LitScene.published(name, SCENES[name]), options.finest
        while len(scene.polygons) * finest**2 > options.most_patches and finest % 2 == 0:
            finest //= 2
        begin = time.perf_counter()
        kept = tuple(level for level in levels if level < finest and finest % level == 0)
        lines += run_scene(scene, kept, finest, options.seed, options.threads)
        with (options.output / "discretization.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in x.items()} for x in lines)
        draw(options.output / f"{name}.png", [line for line in lines if line["scene"] == name])
        print(f"{name}: reference of {len(scene.polygons) * finest**2} patches, {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    sys.exit(main())
