"""Reference light: paths followed through the artist's own surfaces until they are absorbed or leave.

Nothing that makes the bake fast has a part in it: no patches, no merged faces, no kept hits, no nodes, nothing
interpolated. Each hit reads the color of the very place that was met, each stop asks the lights, and a path is ended by
chance with a probability that is paid back, so the expected value is the light itself (Kajiya 1986, "The Rendering
Equation"; Arvo and Kirk 1990, "Particle Transport and Image Synthesis", for the roulette).

Shared with the bake are the ray engine, the lamps' own formulas and what is a light: a fault in those does not show
here. Cost: a path meets 1 / (1 - reflectance) surfaces on the mean, and sends one ray to one light at each; the error
falls with the square root of the number of paths.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from ..cleaning import MAX_REFLECTANCE, clamped_emission, clamped_reflectance, clean
from ..discretization.merging import merge_coplanar
from ..form_factors.cached_hemispheres import GRAZING
from ..form_factors.sampling import hemisphere_directions, kronecker_points
from ..frames import turned_frames
from ..keys import row_keys
from ..lights.direct_light import MAX_LIGHTS, choose_lights, direct_light
from ..lights.emissive import area_lights
from ..scene import Scene, Sky, Surfaces
from ..visibility.before_hits import before_hits
from ..visibility.embree import CHUNK_RAYS, OFFSET, Frame, RayPool, Tracer

#: Rays to each light from a receiver.
DIRECT_RAYS = 1024

#: Places on a light of which a stop of a path looks at one, drawn by what they would give.
LIGHT_PLACES = 16

#: Stops from which on a path may be ended by chance. It goes on with the probability of what it carries, so that what
#: goes on carries no more. One that were ended more often would have to make up for it, and among bright walls there
#: would be no end to its scatter.
SURE_STOPS = 3

#: Paths followed at a time: about 200 bytes each.
BLOCK_PATHS = 65_536


@dataclass(frozen=True)
class PathScene:
    """The scene in the unit frame as paths see it: every triangle as it was read.

    `rows` (m,) are the triangles' rows in what the shader knows; `shining` (m,) those whose emission lights stand for;
    `lights` are in the unit frame.
    """

    frame: Frame
    surfaces: Surfaces
    rows: np.ndarray
    shining: np.ndarray
    lights: list
    sky: Sky | None
    tracer: Tracer

    @classmethod
    def of(cls, scene: Scene) -> PathScene:
        """From a scene in meters, broken triangles left out."""
        cleaned = clean(scene.surfaces)
        surfaces = cleaned.surfaces
        frame = Frame.around(np.asarray(surfaces.vertices, dtype=np.float64))
        surfaces = replace(surfaces, vertices=(surfaces.vertices - frame.center) / frame.size)
        lamps = [light.in_frame(frame.center, frame.size) for light in scene.lights if np.any(light.power > 0)]
        worn = surfaces.palette_of(np.arange(len(surfaces.triangles)))
        power = sum(float(light.power.max()) for light in lamps)
        emissive, shining = _emissive_lights(surfaces, surfaces.emission[worn], power)
        tracer = Tracer.build(surfaces.vertices.astype(np.float32), surfaces.triangles, surfaces.transmittance[worn])
        sky = None if scene.sky_is_dark else scene.sky
        return cls(frame, surfaces, cleaned.rows, shining, [*lamps, *emissive], sky, tracer)

    @property
    def area(self) -> float:
        """Area of all triangles, in unit lengths."""
        corners = self.surfaces.vertices[self.surfaces.triangles]
        return float(
            np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
        )

    def colors(self, triangles: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reflectance and emission (n, 3) at hits, without what lights stand for.

        A ray passes a translucent triangle or stops at it; what it then sees is the part that does not let through.
        """
        surfaces = self.surfaces
        worn = surfaces.palette_of(triangles)
        reflectance, emission = surfaces.reflectance[worn], surfaces.emission[worn]
        varied = np.nonzero(surfaces.textured[triangles])[0]
        if len(varied) and surfaces.shader is not None:
            weights = np.stack([1 - u[varied] - v[varied], u[varied], v[varied]], axis=1).astype(np.float64)
            read = surfaces.shader(self.rows[triangles[varied]], np.clip(weights, 0, 1))
            reflectance[varied], emission[varied] = clamped_reflectance(read[0]), clamped_emission(read[1])
        emission[self.shining[triangles]] = 0
        solid = np.maximum(1 - surfaces.transmittance[worn], 1e-6)[:, None]
        return np.minimum(reflectance / solid, MAX_REFLECTANCE), emission / solid


def _emissive_lights(surfaces: Surfaces, emission: np.ndarray, lamp_power: float) -> tuple[list, np.ndarray]:
    """Lights made of the emissive triangles, and which triangles (m,) they stand for; `emission` (m, 3) of each.

    A lamp that the artist has divided is put together first: as one polygon its light is exact and cheap.
    """
    shining = np.zeros(len(emission), bool)
    glowing = np.nonzero(emission.any(axis=1))[0]
    if not len(glowing):
        return [], shining
    alone = np.where(surfaces.textured[glowing], np.arange(1, len(glowing) + 1), 0)
    _, keys = np.unique(row_keys(surfaces.materials[glowing], surfaces.two_sided[glowing], alone), return_inverse=True)
    merged = merge_coplanar(surfaces.vertices, surfaces.triangles[glowing], keys.reshape(-1))
    rest = np.nonzero(~emission.any(axis=1))[0]
    source = np.concatenate([rest, glowing[merged.source]])
    triangles = np.concatenate([surfaces.triangles[rest], merged.triangles])
    lights, chosen = area_lights(surfaces.vertices, triangles, emission[source], surfaces.two_sided[source], lamp_power)
    # Whole looks are chosen: those of one emission.
    _, looks = np.unique(emission[glowing], axis=0, return_inverse=True)
    looks = looks.reshape(-1)
    shining[glowing] = np.isin(looks, looks[merged.source[chosen[len(rest) :]]])
    return lights, shining


def direct_reference(
    scene: PathScene, points: np.ndarray, normals: np.ndarray, seed: int, pool: RayPool
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Irradiance (n, 3) in W/m2 that n oriented points in the unit frame get from lights, and the rays it took."""
    alone = np.empty((0, 2), np.int32)
    return direct_light(
        scene.tracer, scene.lights, points, normals, alone, DIRECT_RAYS, pool, seed, everywhere=True, most=MAX_LIGHTS
    )


@dataclass(frozen=True)
class FollowedLight:
    """Irradiance in W/m2 that n receivers get by way of other surfaces, or from the sky and what glows faintly.

    Parameters
    ----------
    indirect : (2, n, 3) float64
        Two independent answers of equal quality; their mean is the best one.
    backs : (n,) float64
        Share of the first hits that were backs.
    rays : int
    """

    indirect: np.ndarray
    backs: np.ndarray
    rays: int


def followed_light(
    scene: PathScene, points: np.ndarray, normals: np.ndarray, paths: int, seed: tuple[int, ...], pool: RayPool
) -> Generator[float, None, FollowedLight]:
    """Follow `paths` paths from each of n oriented points, half of them for each answer; yields the share done.

    Parameters
    ----------
    points, normals : (n, 3) float32
        In the unit frame.
    seed : tuple of int
        Other numbers give other paths.
    """
    half = max(paths // 2, 1)
    indirect, backs, rays = np.zeros((2, len(points), 3)), np.zeros(len(points)), 0
    block = max(1, BLOCK_PATHS // half)
    starts = range(0, len(points), block)
    for number in range(2):
        for step, start in enumerate(starts):
            part = slice(start, start + block)
            generator = np.random.default_rng([*seed, number, start])
            indirect[number, part], behind, spent = _follow(scene, points[part], normals[part], half, generator, pool)
            backs[part] += behind / 2
            rays += spent
            yield (number + (step + 1) / len(starts)) / 2
    return FollowedLight(indirect, backs, rays)


def _follow(scene: PathScene, points, normals, paths: int, generator, pool: RayPool):
    """Indirect irradiance (n, 3), share of first hits on backs (n,), and rays."""
    count = len(points)
    out, backs = np.zeros((count, 3)), np.zeros(count)
    # Even over each receiver's hemisphere, moved by chance: two such sets are independent.
    square = (kronecker_points(paths, 2) + generator.random((count, 1, 2))) % 1.0
    directions = _turned(normals, hemisphere_directions(square))
    owners = np.repeat(np.arange(count), paths)
    starts = np.repeat(points + np.float32(OFFSET) * normals, paths, axis=0)
    shares = np.ones((len(owners), 3))
    rays, stop = 0, 0
    while len(owners):
        luck = None if scene.tracer.veil is None else generator.random(len(owners), dtype=np.float32)
        triangles, u, v, behind, places, facing = _met(scene.tracer, starts, directions, luck, pool)
        rays += len(owners)
        if not stop:
            backs = np.bincount(owners, weights=behind, minlength=count) / paths
        gone = triangles < 0
        if scene.sky is not None:
            _add(out, owners[gone], shares[gone] * (np.pi * scene.sky.towards(directions[gone])))
        kept = np.nonzero(~gone & ~(behind & ~scene.surfaces.two_sided[triangles]))[0]
        owners, shares, places, facing = (a[kept] for a in (owners, shares, places, facing))
        reflectance, emission = scene.colors(triangles[kept], u[kept], v[kept])
        _add(out, owners, shares * emission)
        shares = shares * reflectance
        lasting = np.nonzero(shares.max(axis=1) > 0)[0]
        owners, shares, places, facing = (a[lasting] for a in (owners, shares, places, facing))
        light, cost = _glimpsed(scene, places, facing, generator, pool)
        rays += cost
        _add(out, owners, shares * light)
        stop += 1
        if stop >= SURE_STOPS:
            chance = np.minimum(shares.max(axis=1), 1.0)
            lasting = np.nonzero(generator.random(len(chance)) < chance)[0]
            owners, places, facing = (a[lasting] for a in (owners, places, facing))
            shares = shares[lasting] / chance[lasting, None]
        starts = places
        directions = _turned(facing, hemisphere_directions(generator.random((len(facing), 1, 2))))
    return out / paths, backs, rays


def _glimpsed(scene: PathScene, points, normals, generator, pool: RayPool):
    """Direct light (n, 3) by one ray to one place of one light, whose mean is the whole of it; and the rays sent."""
    out = np.zeros((len(points), 3))
    if not scene.lights or not len(points):
        return out, 0
    points = (points + np.float32(OFFSET) * normals).astype(np.float32)
    choices = choose_lights(scene.lights, points, normals, int(generator.integers(2**31)), 1)
    rays = 0
    for light, choice in zip(scene.lights, choices, strict=True):
        asked = np.arange(len(points)) if choice.receivers is None else choice.receivers
        strength = light.geometry(points[asked], normals[asked])
        strength = strength if choice.factors is None else strength * choice.factors
        lit = strength > 0
        asked, strength = asked[lit], strength[lit]
        if not len(asked):
            continue
        rays += len(asked)
        segments, weights = light.aim(points[asked], normals[asked], LIGHT_PLACES)
        # Where no place contributes only a sliver of the light does: then any.
        weights = np.where(weights.sum(axis=1, keepdims=True) > 0, weights, 1.0)
        upto = np.cumsum(weights, axis=1)
        mark = generator.random(len(asked)) * upto[:, -1]
        place = np.minimum((upto <= mark[:, None]).sum(axis=1), weights.shape[1] - 1)
        segments = segments[np.arange(len(asked)), place].astype(np.float32)
        out[asked] += (strength * _passed(scene.tracer, points[asked], segments, pool))[:, None] * light.color
    return out, rays


def _passed(tracer: Tracer, starts, segments, pool: RayPool) -> np.ndarray:
    """Share (n,) of light that passes along segments (n, 3)."""
    passed = np.empty(len(starts), np.float32)

    def work(start: int, stop: int) -> None:
        passed[start:stop] = tracer.visibility(starts[start:stop], segments[start:stop])

    pool.run(work, len(starts), CHUNK_RAYS)
    return passed


def _met(tracer: Tracer, starts, directions, luck, pool: RayPool):
    """Triangle (n,) that each ray meets, -1 for none, its u and v there, whether it is met from behind, the place just
    before it (n, 3), and the normal towards it (n, 3)."""
    count = len(starts)
    triangles, behind = np.empty(count, np.int64), np.empty(count, bool)
    u, v = np.empty(count, np.float32), np.empty(count, np.float32)
    places, facing = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        hits = tracer.closest(starts[part], directions[part], None if luck is None else luck[part])
        triangles[part], u[part], v[part] = hits["primID"], hits["u"], hits["v"]
        places[part], facing[part], cosines = before_hits(starts[part], directions[part], hits)
        behind[part] = (hits["primID"] >= 0) & (cosines > GRAZING)

    pool.run(work, count, CHUNK_RAYS)
    return triangles, u, v, behind, places, facing


def _turned(normals: np.ndarray, local: np.ndarray) -> np.ndarray:
    """(n k, 3) float32 directions (n, k, 3) about +z, turned to n normals."""
    frames = turned_frames(normals.astype(np.float64), np.zeros(len(normals)))
    return np.matmul(local, frames).reshape(-1, 3).astype(np.float32)


def _add(out: np.ndarray, owners: np.ndarray, values: np.ndarray) -> None:
    for channel in range(3):
        out[:, channel] += np.bincount(owners, weights=values[:, channel], minlength=len(out))
