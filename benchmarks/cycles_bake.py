"""What Cycles bakes into the vertices of a mesh: irradiance over pi, by path tracing.

Settings are those that make Cycles solve the same problem as radiosity: diffuse light without the surface's color,
direct and indirect, many bounces, nothing clamped or filtered, every sample of the same worth, on all cores.

Cycles starts one job per selected object, so many small meshes are slow: `join_meshes` first, which was measured
fastest. Samples sit exactly on the vertex; see `geometry.INTERIOR`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import addon_utils
import bpy
import numpy as np

from .scenes import select_only

ATTRIBUTE = "Cycles"
BOUNCES = 16

#: Bounces of a reference, which is to have all light: under a pillow that reflects 0.999 sixteen are a third of it.
REFERENCE_BOUNCES = 64


@dataclass(frozen=True)
class CyclesBake:
    """Values (n, 3) of all vertices of the baked objects, one object after the other, and what they took."""

    values: np.ndarray
    seconds: float  # scene synchronization and writing the attribute included
    samples: int


def read_vertex_colors(obj: bpy.types.Object, name: str) -> np.ndarray:
    """(n, 3) float32 values of a point attribute."""
    attribute = obj.data.color_attributes[name]
    if attribute.domain != 'POINT':
        raise ValueError(f"Attribute {name!r} of {obj.name!r} is per {attribute.domain.lower()}, not per point")
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3]


def bake_by_cycles(
    objects: Sequence[bpy.types.Object], samples: int, seed: int = 0, threads: int = 0, bounces: int = BOUNCES
) -> CyclesBake:
    """Bake these objects in the open scene, `samples` paths per vertex.

    Attributes are made before the clock starts, as a user would have them.
    """
    addon_utils.enable("cycles")
    scene = bpy.context.scene
    _configure(scene, samples, seed, threads, bounces)
    for obj in objects:
        colors = obj.data.color_attributes
        if ATTRIBUTE not in colors:
            colors.new(ATTRIBUTE, 'FLOAT_COLOR', 'POINT')
        colors.active_color = colors[ATTRIBUTE]
    select_only(*objects)
    start = time.perf_counter()
    bpy.ops.object.bake(type='DIFFUSE', pass_filter={'DIRECT', 'INDIRECT'}, target='VERTEX_COLORS')
    seconds = time.perf_counter() - start
    return CyclesBake(np.concatenate([read_vertex_colors(obj, ATTRIBUTE) for obj in objects]), seconds, samples)


def _configure(scene: bpy.types.Scene, samples: int, seed: int, threads: int, bounces: int) -> None:
    scene.render.engine = 'CYCLES'
    scene.render.threads_mode = 'FIXED' if threads else 'AUTO'
    if threads:
        scene.render.threads = threads
    cycles = scene.cycles
    cycles.device = 'CPU'
    cycles.samples = samples
    cycles.seed = seed
    cycles.use_animated_seed = False
    cycles.time_limit = 0
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.transparent_max_bounces = bounces
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.use_fast_gi = False
    # Dropping weak lights and paths at random keeps the mean; the threshold would only add noise.
    cycles.light_sampling_threshold = 0


def join_meshes(objects: Sequence[bpy.types.Object]) -> bpy.types.Object:
    """Make one object of several in the open scene; theirs are gone. Modifiers of all but the first are not applied."""
    select_only(*objects)
    if len(objects) > 1:
        bpy.ops.object.join()
    return bpy.context.view_layer.objects.active


@dataclass(frozen=True)
class Reference:
    """Mean of two bakes with different seeds, and the noise that is left in it.

    Parameters
    ----------
    values : (n, 3) float
    halves : two (n, 3) float
        The bakes it is the mean of: their difference measures their noise without knowing the truth.
    samples : int
        Per half.
    """

    values: np.ndarray
    halves: tuple[np.ndarray, np.ndarray]
    samples: int

    @classmethod
    def from_halves(cls, first: np.ndarray, second: np.ndarray, samples: int) -> Reference:
        first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
        return cls((first + second) / 2, (first, second), samples)

    def noise(self, mask: np.ndarray) -> float:
        """RMS error of `values` at these vertices, relative to the mean: half the RMS difference of the halves."""
        first, second = (half[mask] for half in self.halves)
        return rms(first - second) / 2 / mean(self.values[mask])

    def error(self, values: np.ndarray, mask: np.ndarray) -> float:
        """Relative RMS error of other values at these vertices, the reference's own noise taken out."""
        found = rms(values[mask] - self.values[mask]) / mean(self.values[mask])
        return float(np.sqrt(max(0.0, found**2 - self.noise(mask) ** 2)))

    def bias(self, values: np.ndarray, mask: np.ndarray) -> float:
        """Relative difference of the means over vertices and channels."""
        return mean(values[mask]) / mean(self.values[mask]) - 1


def reference_bake(objects: Sequence[bpy.types.Object], samples: int) -> Reference:
    """Two bakes by Cycles with different seeds, `samples` each, and as good as all bounces."""
    halves = [bake_by_cycles(objects, samples, seed=seed, bounces=REFERENCE_BOUNCES).values for seed in (101, 202)]
    return Reference.from_halves(*halves, samples)


def mean(values: np.ndarray) -> float:
    """Mean over vertices and channels."""
    return float(np.mean(values, dtype=np.float64))


def rms(values: np.ndarray) -> float:
    """Root of the mean square over vertices and channels."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def noise_constant(samples: Sequence[int], errors: Sequence[float]) -> float:
    """c of ``error = c / sqrt(samples)``, fitted to relative errors at two or more sample counts.

    Path tracing errs by chance alone, so one constant tells the error at any count: samples for an error e are
    ``(c / e) ** 2``.
    """
    samples, errors = np.asarray(samples, dtype=float), np.asarray(errors, dtype=float)
    return float(np.exp(np.mean(np.log(errors * np.sqrt(samples)))))
