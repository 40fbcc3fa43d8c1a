"""Rays through embree: the only module that imports embreex.

embreex speaks float32 only; an occlusion query returns 0 for blocked and -1 for free; distances come in lengths of the
direction; ``DISTANCE`` and ``output=True`` overwrite the limits passed in, so each call gets its own. It releases the
GIL, so chunks of rays run in threads. All of this ends here.

Cost: about 0.1 microseconds a ray and core on coarse meshes, up to 0.5 on a million triangles. Embree tests in float32:
geometry is moved to the origin and scaled to unit size first, and rays must start `RayEngine.offset` above a surface.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..errors import MissingRayEngineError

#: Rays handed to one thread at a time. Below 16k two threads spend their time handing over the GIL; above 64k nothing
#: is gained and the buffers leave the cache (measured, benchmarks/ray_engine).
CHUNK_RAYS = 32768

#: Start of a ray above its surface, in units of the scene's longest side. float32 steps at 0.5 are 6e-8, and self hits
#: were measured to vanish above 1e-7; the margin covers long thin triangles.
OFFSET = 1e-5

#: Part of a shadow ray's length that is tested: one that ends exactly on the light's surface hits the light.
SHADOW_LENGTH = 0.9999

_BLOCKED = 0  # embreex's answer to an OCCLUDED query that met something


def is_available() -> bool:
    """Whether embreex can be imported on this platform."""
    try:
        from embreex import rtcore_scene  # noqa: F401  (probing the compiled part: `import embreex` alone proves nothing)
    except ImportError:
        return False
    return True


@cache
def _device():
    """The Embree device of all scenes, which never ends.

    By default each scene of embreex owns a device. Garbage collection may take that away first (a traceback refers to
    the scene in a cycle, say) and the scene is then released with a device that is gone. That crashes where embreex
    works on Blender's own libembree4 and allocator, which the loader prefers to embreex's when Blender links them.
    The same at exit; so one reference to the device is never given back.
    """
    from embreex import rtcore

    device = rtcore.EmbreeDevice()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(device))
    return device


def _embree_scene(vertices: np.ndarray, triangles: np.ndarray):
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError as error:
        raise MissingRayEngineError(
            "Cannot trace rays: the embreex package is missing. Install the Radiosity extension made for this platform "
            "(there is none for Windows or Linux on ARM)"
        ) from error
    scene = rtcore_scene.EmbreeScene(_device(), robust=True)
    if len(triangles):
        mesh_construction.TriangleMesh(
            scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(triangles, dtype=np.int32),
        )
    # The first query builds the tree, and must not be asked by two threads at once.
    nothing = np.ones((1, 3), np.float32)
    scene.run(nothing, nothing, query="OCCLUDED")
    return scene


@dataclass(frozen=True)
class Frame:
    """Similarity that moves a scene to the origin and scales its longest side to 1."""

    center: np.ndarray
    size: float

    @classmethod
    def around(cls, points: np.ndarray) -> Frame:
        """Frame of the bounding box of (n, 3) finite points; size 1 where they coincide or there are none."""
        if not len(points):
            return cls(np.zeros(3), 1.0)
        low, high = points.min(axis=0), points.max(axis=0)
        # Halve before adding: the sum of two large coordinates may overflow.
        size = float((high - low).max())
        return cls(low / 2 + high / 2, size if size > 0 else 1.0)

    def to_unit(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) float32 points in the unit frame; the subtraction is done in float64."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.center) / self.size, dtype=np.float32)


@dataclass
class Tracer:
    """Triangles in the unit frame, ready for rays. float32 in, plain arrays out, no threads of its own.

    `transmittance` (m,) lets light through in proportion: shadow rays are dimmed by it, and a closest-hit ray passes a
    triangle when its `luck` lies below it.
    """

    scene: object
    opaque: object
    veil: object | None  # the translucent triangles alone
    veil_triangles: np.ndarray
    transmittance: np.ndarray

    @classmethod
    def build(cls, vertices: np.ndarray, triangles: np.ndarray, transmittance: np.ndarray | None = None) -> Tracer:
        """Acceleration structures for (n, 3) float32 vertices in the unit frame and (m, 3) triangles."""
        scene = _embree_scene(vertices, triangles)
        if transmittance is None or not np.any(transmittance > 0):
            return cls(scene, scene, None, np.empty(0, np.int64), np.zeros(len(triangles), np.float32))
        veil = np.nonzero(transmittance > 0)[0]
        opaque = triangles[transmittance <= 0]
        return cls(
            scene,
            _embree_scene(vertices, opaque) if len(opaque) else None,
            _embree_scene(vertices, triangles[veil]),
            veil,
            np.asarray(transmittance, dtype=np.float32),
        )

    def closest(self, origins: np.ndarray, directions: np.ndarray, luck: np.ndarray | None = None) -> dict:
        """First hit of each ray: primID (-1 for none), u, v, tfar and Ng (unnormalized, by winding)."""
        hits = self.scene.run(origins, directions, output=True)
        if self.veil is None or luck is None:
            return hits
        travelled = np.zeros(len(origins), np.float32)
        seen = np.arange(len(origins))
        luck = luck.copy()
        while True:
            primitive = hits["primID"][seen]
            passing = self.transmittance[primitive] * (primitive >= 0)
            through = luck[seen] < passing
            if not through.any():
                break
            seen = seen[through]
            # The share of luck used up is stretched back to [0, 1) for the next layer.
            luck[seen] /= passing[through]
            travelled[seen] += hits["tfar"][seen] + np.float32(OFFSET)
            onward = self.scene.run(
                origins[seen] + travelled[seen, None] * directions[seen], directions[seen], output=True
            )
            for name in ("primID", "u", "v", "Ng"):
                hits[name][seen] = onward[name]
            hits["tfar"][seen] = onward["tfar"]
        hits["tfar"] += travelled
        return hits

    def visibility(self, origins: np.ndarray, segments: np.ndarray, length: float = SHADOW_LENGTH) -> np.ndarray:
        """Share of light (n,) float32 that passes along each segment, from 0 (blocked) to 1."""
        limit = np.full(len(origins), length, np.float32)
        if self.opaque is None:
            light = np.ones(len(origins), np.float32)
        else:
            blocked = self.opaque.run(origins, segments, dists=limit, query="OCCLUDED")
            light = (blocked != _BLOCKED).astype(np.float32)
        if self.veil is not None:
            self._dim(light, origins, segments, length)
        return light

    def _dim(self, light: np.ndarray, origins: np.ndarray, segments: np.ndarray, length: float) -> None:
        seen = np.nonzero(light > 0)[0]
        travelled = np.zeros(len(origins), np.float32)
        step = np.float32(OFFSET) / np.maximum(np.linalg.norm(segments, axis=1), np.float32(1e-20))
        while len(seen):
            left = length - travelled[seen]
            hits = self.veil.run(
                origins[seen] + travelled[seen, None] * segments[seen],
                segments[seen],
                dists=np.maximum(left, 0).astype(np.float32),
                output=True,
            )
            met = hits["primID"] >= 0
            seen = seen[met]
            light[seen] *= self.transmittance[self.veil_triangles[hits["primID"][met]]]
            travelled[seen] += hits["tfar"][met] + step[seen]
            seen = seen[(light[seen] > 0) & (travelled[seen] < length)]


class RayPool:
    """Threads that work through chunks of rays. Every chunk writes its own slice, so the number of threads and their
    order change nothing in the result."""

    def __init__(self, threads: int = 0):
        self.threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None

    def __enter__(self) -> RayPool:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """End the threads; waits for the chunks that run."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def chunks(self, work: Callable[[int, int], None], count: int, size: int):
        """Call ``work(start, stop)`` for slices of `count` items of `size` each; yields the share done after each."""
        starts = range(0, count, max(1, size))
        if self._pool is None:
            for start in starts:
                work(start, min(start + size, count))
                yield min(start + size, count) / count
            return
        jobs = [self._pool.submit(work, start, min(start + size, count)) for start in starts]
        try:
            for done, job in enumerate(jobs, 1):
                job.result()
                yield done / len(jobs)
        finally:
            for job in jobs:
                job.cancel()
            # A chunk that runs still writes into arrays of the caller: let it end before they are given up.
            for job in jobs:
                if not job.cancelled():
                    job.exception()

    def run(self, work: Callable[[int, int], None], count: int, size: int) -> None:
        """`chunks`, to the end."""
        for _ in self.chunks(work, count, size):
            pass


def free_ways(tracer: Tracer, starts: np.ndarray, segments: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) bool: whether light passes along each whole segment (n, 3) from its start (n, 3)."""
    free = np.empty(len(starts), bool)

    def work(start: int, stop: int) -> None:
        part = (array[start:stop].astype(np.float32) for array in (starts, segments))
        free[start:stop] = tracer.visibility(*part, 1.0) > 0

    pool.run(work, len(starts), CHUNK_RAYS)
    return free


class RayEngine:
    """Rays in world coordinates, for callers that do not build the rays themselves.

    Parameters
    ----------
    vertices : (n, 3) float
        In any units; finite where a triangle uses them.
    triangles : (m, 3) int
    threads : int
        0 takes all cores. The result does not depend on it.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, threads: int = 0):
        vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        triangles = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
        self.frame = Frame.around(vertices[np.unique(triangles)])
        self.tracer = Tracer.build(self.frame.to_unit(vertices), triangles)
        self.pool = RayPool(threads)

    @property
    def offset(self) -> float:
        """Length by which callers move origins off their own surface."""
        return OFFSET * self.frame.size

    def closest(self, origins: np.ndarray, directions: np.ndarray):
        """First hit along each ray.

        Returns
        -------
        triangles : (r,) int32, -1 where nothing is met
        u, v : (r,) float32, weights of the triangle's second and third corner
        distances : (r,) float32, in lengths of the direction, infinite where nothing is met
        """
        count = len(origins)
        triangles = np.empty(count, np.int32)
        u, v, distances = (np.empty(count, np.float32) for _ in range(3))

        def work(start: int, stop: int) -> None:
            # Directions are scaled along with the frame, so distances stay in lengths of the caller's direction.
            along = np.asarray(directions[start:stop], dtype=np.float64) / self.frame.size
            hits = self.tracer.closest(self.frame.to_unit(origins[start:stop]), along.astype(np.float32))
            triangles[start:stop] = hits["primID"]
            u[start:stop], v[start:stop] = hits["u"], hits["v"]
            distances[start:stop] = np.where(hits["primID"] >= 0, hits["tfar"], np.inf)

        self.pool.run(work, count, CHUNK_RAYS)
        return triangles, u, v, distances

    def occluded(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(r,) bool: whether something stands between each origin and its target."""
        blocked = np.empty(len(origins), bool)

        def work(start: int, stop: int) -> None:
            begin = self.frame.to_unit(origins[start:stop])
            blocked[start:stop] = self.tracer.visibility(begin, self.frame.to_unit(targets[start:stop]) - begin) == 0

        self.pool.run(work, len(origins), CHUNK_RAYS)
        return blocked
