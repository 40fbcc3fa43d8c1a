"""How wrong a bake is: some of its stored values against reference light at the same places, with an interval.

The places are receivers drawn evenly, half of them on borders where light changes fastest, which then count by their
number. What is compared is the irradiance behind the stored value: reflectance is divided out, so the number is that
which `accuracy` asks for and the report estimates, whatever was stored. What the storage itself loses, eight bits or a
mean over a vertex, is part of it.

Not measured: places inside solids, where the bake stores the light of the nearest open place and the reference finds
none; corners that a wall cuts off from most of their faces, which store the light of these; surfaces that hardly
reflect, where ``combined`` tells nothing about the light; what interpolation between vertices leaves out; and what bake
and reference share (`light_paths`).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..baked_mesh import BakedMesh
from ..errors import EmptySceneError, SettingsError
from ..gathering.placing import place_receivers
from ..gathering.receivers import Receivers
from ..gathering.walled_off import find_walled_off
from ..progress import Progress, shared_progress
from ..scene import Scene
from ..visibility.embree import RayPool
from .light_paths import PathScene, direct_reference, followed_light
from .measured_error import MeasuredError, measure

#: Places compared, and paths at most from each receiver behind them; and how few of either make sense.
PLACES = 400
PATHS = 16384
LEAST = 16

#: Paths of one round. No further round follows once the reference's own noise is below the error: noise as large adds a
#: twentieth to the width of the interval's half that places alone would leave.
ROUND = 1024

#: Patches by whose size it is judged whether a wall cuts a corner off: as many as a bake of 3 % makes.
TYPICAL_PATCHES = 2700

#: Reflectance below which a stored ``combined`` value does not tell the light that arrived.
LEAST_REFLECTANCE = 0.05

#: A receiver more than half of whose first hits are backs, and whose light is below this part of the mean, lies inside
#: a solid.
INSIDE = 0.5
DARK = 1e-3


@dataclass(frozen=True)
class Verification:
    """What was measured, the places left out because they lie inside solids, the paths followed from each receiver, and
    the rays it took in all."""

    measured: MeasuredError
    left_out: int
    paths: int
    rays: int


@dataclass(frozen=True)
class StoredColors:
    """What a mesh stores: `values` (n, 3) in W/(m2 sr) at its corners, or at its vertices with `at_vertices`; NaN where
    a value was cut off and does not tell the light."""

    values: np.ndarray
    at_vertices: bool


@dataclass(frozen=True)
class _Places:
    """Places drawn: mesh and row of its stored values (n,), stratum, weight, and the receivers behind them all."""

    meshes: np.ndarray
    rows: np.ndarray
    strata: np.ndarray
    weights: np.ndarray
    receivers: np.ndarray


@dataclass(frozen=True)
class _Lit:
    """Irradiance of the receivers drawn: direct (r, 3), two answers for the indirect (2, r, 3), share of backs (r,)."""

    direct: np.ndarray
    indirect: np.ndarray
    backs: np.ndarray

    def halves(self, bake_type: str) -> np.ndarray:
        """(2, r, 3) the light that a bake type stores, by either answer."""
        if bake_type == "indirect":
            return self.indirect
        return self.direct + (0 if bake_type == "direct" else self.indirect)


def verify_steps(
    scene: Scene,
    stored: Sequence[StoredColors],
    bake_type: str = "combined",
    places: int = PLACES,
    paths: int = PATHS,
    seed: int = 0,
    threads: int = 0,
) -> Generator[Progress, None, Verification]:
    """Measure the error of stored colors in steps; the generator's return value is the result.

    Parameters
    ----------
    scene : Scene
        As it was baked.
    stored : sequence of StoredColors
        Of each mesh in `scene.receivers`.
    bake_type : str
        What was stored; see `BakeSettings`.
    places, paths : int
        The interval narrows with the square root of `places`; `paths` only keep the noise of the reference low.

    Raises
    ------
    SettingsError
        If the bake type holds no light that arrives, or places or paths are too few.
    EmptySceneError
        If nothing is there to compare: no corner, no light, no reflecting surface, or all inside solids.
    MissingRayEngineError
        If rays cannot be traced on this platform.
    """
    return (yield from verify_each_steps(scene, [stored], bake_type, places, paths, seed, threads))[0]


def verify_each_steps(
    scene: Scene,
    bakes: Sequence[Sequence[StoredColors]],
    bake_type: str = "combined",
    places: int = PLACES,
    paths: int = PATHS,
    seed: int = 0,
    threads: int = 0,
) -> Generator[Progress, None, list[Verification]]:
    """Measure several bakes of one scene at the same places against one reference, as `verify_steps` does one.

    `bakes` hold colors each, in the same domain. The reference is followed until it is known better than the best.
    """
    if bake_type == "emission":
        raise SettingsError("Emission is read from the materials and has no error to measure: bake another type")
    if places < LEAST or paths < LEAST:
        raise SettingsError(f"At least {LEAST} places and paths are needed, not {places} and {paths}")
    yield Progress(0.0, "Preparing the reference")
    path_scene = PathScene.of(scene)
    with RayPool(threads) as pool:
        frame = path_scene.frame
        meshes = [replace(mesh, positions=frame.to_unit(mesh.positions)) for mesh in scene.receivers]
        receivers = place_receivers(meshes, path_scene.tracer, pool)
        if not len(receivers):
            raise EmptySceneError("No vertex with a light to measure: all baked meshes are empty or broken")
        spacing = np.sqrt(path_scene.area / TYPICAL_PATCHES)
        walled = find_walled_off(path_scene.tracer, meshes, receivers, spacing, pool).receivers
        chosen = _draw(scene, receivers, bakes[0], places, walled, np.random.default_rng(seed))
        points, normals = receivers.points[chosen.receivers], receivers.normals[chosen.receivers]
        yield Progress(0.02, "Direct light of the reference")
        work = shared_progress(direct_reference(path_scene, points, normals, seed, pool), 0.02, 0.1)
        direct, rays = yield from _told(work, "Direct light of the reference")
        indirect, backs, followed = np.zeros((2, *direct.shape)), np.zeros(len(points)), 0
        while True:
            more = min(max(followed, ROUND), paths - followed)
            low, high = (0.1 + 0.9 * done / paths for done in (followed, followed + more))
            work = followed_light(path_scene, points, normals, more, (seed, followed), pool)
            light = yield from _told(shared_progress(work, low, high), "Following light")
            share = more / (followed + more)
            indirect += share * (light.indirect - indirect)
            backs += share * (light.backs - backs)
            followed, rays = followed + more, rays + light.rays
            lit = _Lit(direct, indirect, backs)
            found = [_measured(scene, receivers, stored, bake_type, chosen, lit, seed) for stored in bakes]
            if followed >= paths or all(measured.noise < measured.error for measured, _ in found):
                return [Verification(measured, left_out, followed, rays) for measured, left_out in found]


def _told(work: Generator, message: str) -> Generator[Progress, None, object]:
    while True:
        try:
            fraction = next(work)
        except StopIteration as end:
            return end.value
        yield Progress(fraction, message)


def _measured(scene, receivers, stored, bake_type, chosen: _Places, lit: _Lit, seed) -> tuple[MeasuredError, int]:
    """The error at the places that are not inside solids, and how many are."""
    values, halves, buried = _compared(scene, receivers, stored, bake_type, chosen, lit)
    usable = ~buried & np.isfinite(values).any(axis=1)
    if not usable.any():
        raise EmptySceneError(
            "No place to measure at: what was baked lies inside solids, reflects too little to show its light, or was "
            "cut off at white"
        )
    if not halves[:, usable].any():
        raise EmptySceneError("No light arrives at any place looked at: there is nothing to relate an error to")
    measured = measure(values[usable], halves[:, usable], chosen.weights[usable], chosen.strata[usable], seed)
    return measured, int(buried.sum())


def _draw(scene: Scene, receivers: Receivers, stored, count: int, walled: np.ndarray, generator) -> _Places:
    """Places of receivers that are not `walled` (k,), half of them on borders where there are so many."""
    free = np.ones(len(receivers), bool)
    free[walled] = False
    # The first corner that names each receiver stands for it.
    corner_of, mesh_of = np.full(len(receivers), -1), np.zeros(len(receivers), int)
    for number in reversed(range(len(scene.receivers))):
        corners = receivers.corner_receivers[number]
        named = np.nonzero(corners >= 0)[0][::-1]
        corner_of[corners[named]], mesh_of[corners[named]] = named, number
    kinds = [np.nonzero(receivers.borders & free)[0], np.nonzero(~receivers.borders & free)[0]]
    few = min(len(kind) for kind in kinds)
    drawn, strata, weights = [], [], []
    for stratum, kind in enumerate(kinds):
        number = min(len(kind), max(count // 2, count - few))
        drawn.append(np.sort(generator.choice(kind, number, replace=False)))
        strata.append(np.full(number, stratum))
        weights.append(np.full(number, len(kind) / max(number, 1)))
    drawn = np.concatenate(drawn)
    meshes, rows, needed = mesh_of[drawn], corner_of[drawn], [drawn]
    for number in np.unique(meshes):
        if not stored[number].at_vertices:
            continue
        mine = meshes == number
        vertices = scene.receivers[number].corner_vertices
        rows[mine] = vertices[rows[mine]]
        # A vertex holds the mean of its corners.
        around = np.isin(vertices, rows[mine])
        behind = receivers.corner_receivers[number][around]
        needed.append(behind[behind >= 0])
    return _Places(meshes, rows, np.concatenate(strata), np.concatenate(weights), np.unique(np.concatenate(needed)))


def _compared(scene: Scene, receivers: Receivers, stored, bake_type: str, chosen: _Places, lit: _Lit):
    """Irradiance (n, 3) behind the stored values, (2, n, 3) by reference, and which places lie inside solids."""
    total = lit.halves("lighting")
    light = np.broadcast_to(lit.halves(bake_type), total.shape)
    dark = total.mean(axis=(0, 2)) <= DARK * total.mean()
    inside = np.zeros(len(receivers), bool)
    inside[chosen.receivers] = dark & (lit.backs > INSIDE)
    count = len(chosen.rows)
    values, halves, buried = np.full((count, 3), np.nan), np.zeros((2, count, 3)), np.zeros(count, bool)
    for number in np.unique(chosen.meshes):
        mine = np.nonzero(chosen.meshes == number)[0]
        rows, mesh, colors = chosen.rows[mine], scene.receivers[number], stored[number]
        vertices = len(mesh.positions)
        expected = vertices if colors.at_vertices else len(mesh.corner_vertices)
        if len(colors.values) != expected:
            raise SettingsError(
                f"The colors of {mesh.name!r} do not fit its mesh ({len(colors.values)} for {expected}): bake again"
            )
        baked = BakedMesh(mesh, vertices, receivers.corner_receivers[number], None, None, inside)
        behind = _behind(baked, colors.at_vertices, rows, bake_type, len(receivers))
        black = behind(np.zeros((len(receivers), 3), np.float32))
        gain = behind(np.ones((len(receivers), 3), np.float32)) - black
        told = gain > LEAST_REFLECTANCE / np.pi
        gain = np.where(told, gain, np.nan)
        values[mine] = (colors.values[rows] - black) / gain
        for half in range(2):
            everywhere = np.zeros((len(receivers), 3), np.float32)
            everywhere[chosen.receivers] = light[half]
            halves[half, mine] = np.where(told, (behind(everywhere) - black) / gain, 0)
        buried[mine] = _all_inside(baked, colors.at_vertices, rows)
    return values, halves, buried


def _behind(baked: BakedMesh, at_vertices: bool, rows: np.ndarray, bake_type: str, receivers: int):
    """Function from irradiance (r, 3) of all receivers to the values (n, 3) that the bake would store at `rows`."""
    nothing = np.zeros((receivers, 3), np.float32)
    # Which part of the light it is does not matter here: what is given is what is stored.
    part = "combined" if bake_type == "combined" else "lighting"

    def stored(irradiance: np.ndarray) -> np.ndarray:
        lit = replace(baked, direct=irradiance, indirect=nothing)
        return (lit.vertex_colors(part) if at_vertices else lit.corner_colors(part))[rows].astype(np.float64)

    return stored


def _all_inside(baked: BakedMesh, at_vertices: bool, rows: np.ndarray) -> np.ndarray:
    """(n,) bool: whether all corners behind the stored values at `rows` lie inside solids."""
    buried = baked.buried_corners
    if not at_vertices:
        return buried[rows]
    vertices = baked.mesh.corner_vertices
    open_corners = np.bincount(vertices, weights=~buried, minlength=baked.vertices)
    return open_corners[rows] == 0
