"""Light at receivers by brute force, and by it the error of a bake: inside faces, at their borders, and everywhere.

    python -m benchmarks.dense_reference OUTPUT.csv [--scenes cornell_box,...] [--accuracies 0.1,0.03,0.01] ...

The reference asks the scene as the bake sees it, at the bake's own receivers, so it measures the method and nothing
else. It shares no node, no interpolation and no patch that a receiver sees: all its rays are followed on for `LEVELS`
reflections, each with the lights' direct light in closed form and visibility by rays, and only the light that comes
after those is looked up, in patches much finer than a bake's. Two halves with turned samples tell its own noise, which
is taken out of every error; the share of the patches behind the last reflection shows by another `--patches`.

Receivers are drawn: as many on borders (where a face ends: edges, corners, contacts) as within faces; those inside
solids, or hidden in a slot, have no light to compare. Errors are RMS over receivers and channels, over the mean
irradiance of all receivers; "all" weighs borders by their true number.
"""

from __future__ import annotations

import argparse
import csv
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from radiosity.core.bake import bake_steps
from radiosity.core.bake_model import build_model, in_unit_frame, patch_solution_of
from radiosity.core.bake_plan import plan_for
from radiosity.core.cleaning import clean
from radiosity.core.form_factors.sampling import frames, hemisphere_directions, kronecker_points
from radiosity.core.gathering.placing import place_receivers
from radiosity.core.gathering.receivers import Receivers
from radiosity.core.lights.direct_light import direct_light
from radiosity.core.progress import finish
from radiosity.core.scene import Scene
from radiosity.core.settings import BakeSettings
from radiosity.core.visibility.embree import CHUNK_RAYS, OFFSET, Frame, RayPool

from . import scenes

SCENES = {
    "cornell_box": scenes.cornell_box,
    "furnished_room": scenes.furnished_room,
    "l_room": scenes.l_room,
}

#: Reflections that are followed by rays before patches are asked.
LEVELS = 2

#: Rays per light where its visibility is in doubt, at receivers and at the reflections behind them.
PENUMBRA_RAYS, HIT_PENUMBRA_RAYS = 1024, 16

#: What faces something nearer than this part of the scene's size is seen by nobody: the slot between lamp and ceiling.
HIDDEN = 1e-3

#: Hits worked on at a time: a few hundred MB.
BLOCK_HITS = 400_000

#: Turns of the samples of the two halves.
SEEDS = (101, 202)


@dataclass(frozen=True)
class DenseReference:
    """Irradiance (n, 3) of `chosen` (n,) receivers: direct, and indirect in two halves (2, n, 3)."""

    chosen: np.ndarray
    direct: np.ndarray
    halves: np.ndarray


class _Paths:
    """Follows rays through a scene prepared as a bake prepares it, with patches of its own."""

    def __init__(self, scene: Scene, patches: int, pool: RayPool):
        coarse = plan_for(0.01)
        plan = replace(coarse, patches=patches, patch_rays=64, penumbra_rays=256, tolerance=1e-5)
        cleaned = clean(scene.surfaces)
        self.pool = pool
        frame = Frame.around(np.asarray(cleaned.surfaces.vertices, dtype=np.float64))
        surfaces = in_unit_frame(cleaned.surfaces, frame)
        meshes = [replace(mesh, positions=frame.to_unit(mesh.positions)) for mesh in scene.receivers]
        settings = BakeSettings(accuracy=0.01, seed=77)
        self.model = build_model(surfaces, frame, cleaned.rows, scene, plan, settings, pool)
        self.receivers = place_receivers(meshes, self.model.tracer, pool)
        self.solution = patch_solution_of(self.model, scene, plan, settings, pool)
        finish(self.solution.solve())
        self.table = self.solution.table()[:, :3]

    def hidden(self) -> np.ndarray:
        """(r,) bool: receivers that face something nearer than `HIDDEN`."""
        starts = (self.receivers.points + np.float32(OFFSET) * self.receivers.normals).astype(np.float32)
        return self.model.tracer.visibility(starts, np.float32(HIDDEN) * self.receivers.normals, 1.0) < 1

    def direct(self, points: np.ndarray, normals: np.ndarray, rays: int, everywhere: bool) -> np.ndarray:
        alone = np.empty((0, 2), np.int32)
        work = direct_light(
            self.model.tracer, self.model.lights, points, normals, alone, rays, self.pool, 5, everywhere
        )
        return finish(work)[0]

    def arriving(self, points, normals, square, levels: int) -> np.ndarray:
        """(n, 3) what one ray of each point brings, from points (n, 2 * (levels + 1)) of the unit cube."""
        local = hemisphere_directions(square[:, :2])
        directions = np.einsum("nk,nki->ni", local, frames(normals)).astype(np.float32)
        origins = (points + np.float32(OFFSET) * normals).astype(np.float32)
        triangles, distances = np.empty(len(points), np.int32), np.empty(len(points), np.float32)
        facing, rows = np.empty((len(points), 3), np.float32), np.empty(len(points), np.int32)

        def work(start: int, stop: int) -> None:
            hits = self.model.tracer.closest(origins[start:stop], directions[start:stop])
            triangles[start:stop], distances[start:stop] = hits["primID"], hits["tfar"]
            facing[start:stop] = hits["Ng"]
            rows[start:stop] = self.solution.hits_to_rows.look_up(hits, directions[start:stop])

        self.pool.run(work, len(points), CHUNK_RAYS)
        if self.solution.meet(rows):
            finish(self.solution.follow())
            self.table = self.solution.table()[:, :3]
        light = self.table[rows]
        if not levels:
            return light
        count = self.model.patches.count
        reflecting = np.nonzero((triangles >= 0) & (rows < 2 * count))[0]
        patch = rows[reflecting]
        emitted = self.solution.emitted[patch]
        reflectance = self.solution.reflectances[patch]
        towards = facing[reflecting] / np.linalg.norm(facing[reflecting], axis=1, keepdims=True)
        away = np.einsum("ni,ni->n", towards, directions[reflecting]) > 0
        towards[away] *= -1
        places = origins[reflecting] + distances[reflecting, None] * directions[reflecting]
        arrived = self.direct(places, towards, HIT_PENUMBRA_RAYS, False)
        arrived = arrived + self.arriving(places, towards, square[reflecting, 2:], levels - 1)
        light[reflecting] = emitted + reflectance * arrived
        return light

    def indirect(self, points: np.ndarray, normals: np.ndarray, rays: int, seed: int) -> np.ndarray:
        """(n, 3) irradiance that is not direct."""
        table = kronecker_points(rays, 2 * (LEVELS + 1))
        turns = np.random.default_rng(seed).random((len(points), 1, table.shape[1]))
        out = np.empty((len(points), 3))
        block = max(1, BLOCK_HITS // rays)
        for start in range(0, len(points), block):
            part = slice(start, start + block)
            square = ((table[None] + turns[part]) % 1).reshape(-1, table.shape[1])
            many = [np.repeat(each[part], rays, axis=0) for each in (points, normals)]
            out[part] = self.arriving(*many, square, LEVELS).reshape(-1, rays, 3).mean(axis=1)
        return out


def dense_reference(scene: Scene, count: int, rays: int, patches: int) -> tuple[DenseReference, Receivers]:
    """The reference at up to `count` receivers on borders and as many within faces, and all receivers."""
    with RayPool() as pool:
        paths = _Paths(scene, patches, pool)
        receivers = paths.receivers
        generator = np.random.default_rng(9)
        fair = ~paths.hidden()
        kinds = (np.nonzero(receivers.borders & fair)[0], np.nonzero(~receivers.borders & fair)[0])
        chosen = np.concatenate([np.sort(generator.permutation(kind)[:count]) for kind in kinds])
        points, normals = receivers.points[chosen], receivers.normals[chosen]
        direct = paths.direct(points, normals, PENUMBRA_RAYS, True)
        halves = np.stack([paths.indirect(points, normals, rays, seed) for seed in SEEDS])
    return DenseReference(chosen, direct, halves), receivers


def errors(
    reference: DenseReference, receivers: Receivers, direct: np.ndarray, indirect: np.ndarray, buried: np.ndarray
) -> dict[str, float]:
    """Relative RMS errors of a bake's (r, 3) irradiance, by part and place, and the reference's own noise."""
    chosen, borders = reference.chosen, receivers.borders[reference.chosen]
    seen = ~buried[chosen]
    population = receivers.borders[~buried]
    weight = np.where(
        borders, population.mean() / (borders & seen).sum(), (~population).mean() / (~borders & seen).sum()
    )
    weight = weight * seen
    ours = np.concatenate([direct, indirect], axis=1)[chosen].astype(np.float64)
    whole = weight @ (reference.direct + reference.halves.mean(axis=0)).mean(axis=1)
    apart = [ours[:, 3:] - half for half in reference.halves]
    straight = ours[:, :3] - reference.direct
    # The product of the differences to two independent halves is free of the halves' own noise.
    squares = {
        "direct": straight**2,
        "indirect": apart[0] * apart[1],
        "total": (apart[0] + straight) * (apart[1] + straight),
        "noise": (reference.halves[0] - reference.halves[1]) ** 2 / 4,
    }
    places = {"interior": weight * ~borders, "border": weight * borders, "all": weight}
    return {
        f"{part}_{place}": float(np.sqrt(max(share @ square.mean(axis=1) / share.sum(), 0)) / whole)
        for part, square in squares.items()
        for place, share in places.items()
    }


def read_open_scene() -> Scene:
    """The open scene as the core takes it."""
    from radiosity.addon.adapters.scene_reader import read_scene

    return read_scene(bpy.context, world_strength=None).scene


def measure(name: str, options: argparse.Namespace) -> list[dict]:
    """One row for each accuracy."""
    scene = _scene(name, options.vertices)
    reference, receivers = dense_reference(scene, options.receivers, options.rays, options.patches)
    rows = []
    for accuracy in options.accuracies:
        result = finish(bake_steps(scene, BakeSettings(accuracy=accuracy, seed=options.seed)))
        mesh = result.meshes[0]
        found = errors(reference, receivers, mesh.direct, mesh.indirect, mesh.buried)
        statistics = result.statistics
        row = {"scene": name, "accuracy": accuracy, "seconds": statistics["seconds"]["total"]}
        rows.append({**row, "rays": statistics["rays"], "estimated": statistics["estimated_error"], **found})
    return rows


def _scene(name: str, vertices: int) -> Scene:
    SCENES[name](vertices)
    return read_open_scene()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dense_reference", description=__doc__.splitlines()[0])
    parser.add_argument("output", type=Path, help="table to write")
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=list(SCENES))
    parser.add_argument(
        "--accuracies", type=lambda text: [float(each) for each in text.split(",")], default=[0.1, 0.03, 0.01]
    )
    parser.add_argument("--vertices", type=int, default=20_000)
    parser.add_argument("--receivers", type=int, default=600, help="on borders, and as many within faces")
    parser.add_argument("--rays", type=int, default=1024, help="of each receiver and half of the reference")
    parser.add_argument("--patches", type=int, default=12_000, help="of the reference, behind the last reflection")
    parser.add_argument("--seed", type=int, default=0, help="of the bakes")
    options = parser.parse_args()
    import radiosity

    radiosity.register()
    try:
        rows = [row for name in options.scenes for row in measure(name, options)]
    finally:
        radiosity.unregister()
    with open(options.output, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    for row in rows:
        sys.stdout.write(
            ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()) + "\n"
        )


if __name__ == "__main__":
    main()
