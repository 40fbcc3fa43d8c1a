"""Colors that vary over a triangle: looks evaluated at points, from attributes gathered per look.

For each look that varies, the attributes it asks for are kept per triangle corner in one pool for all objects that wear
it, so that a call costs one evaluation per look and not per object. 24 bytes a textured triangle for UVs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .fields import Samples
from .materials import Look
from .mesh_arrays import AttributeKey

#: Points at which the mean over a textured triangle is taken: at least, at most, and for all triangles of a look
#: together unless the least asks for more.
LEAST_SAMPLES, MOST_SAMPLES, SAMPLE_BUDGET = 16, 1024, 1 << 19

#: Points evaluated at once, to bound memory.
CHUNK = 1 << 18


def evaluate(
    look: Look, attributes: Mapping[AttributeKey, np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A look at points.

    Parameters
    ----------
    look : Look
    attributes : mapping of AttributeKey to (n, k) float32
    count : int
        Number of points n.

    Returns
    -------
    reflectance, emission : (n, 3) float32
    transmittance : (n,) float32
    """
    samples = Samples(attributes, count)
    with np.errstate(all="ignore"):  # the look turns what is not finite into 0
        reflectance, emission, transmittance = (
            field(samples) for field in (look.reflectance, look.emission, look.transmittance)
        )
    return (
        np.broadcast_to(reflectance, (count, 3)),
        np.broadcast_to(emission, (count, 3)),
        np.broadcast_to(transmittance, (count, 1))[:, 0],
    )


class TexturedShader:
    """`core.scene.SurfaceShader` over the looks of a scene.

    Parameters
    ----------
    looks : sequence of Look
        Those that vary.
    pools : sequence of mapping of AttributeKey to (t, 3, k) float32
        Attributes at the corners of the triangles of each look.
    triangle_looks, triangle_rows : (m,) int32
        Look of each triangle of the scene, -1 for none, and its row in the look's pool.
    """

    def __init__(
        self,
        looks: Sequence[Look],
        pools: Sequence[Mapping[AttributeKey, np.ndarray]],
        triangle_looks: np.ndarray,
        triangle_rows: np.ndarray,
    ) -> None:
        self._looks = looks
        self._pools = pools
        self._triangle_looks = triangle_looks
        self._triangle_rows = triangle_rows

    def __call__(self, triangles: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `core.scene.SurfaceShader`. Triangles that are not textured are black here and opaque."""
        triangles = np.asarray(triangles)
        reflectance, emission = np.zeros((2, len(triangles), 3), dtype=np.float32)
        transmittance = np.zeros(len(triangles), dtype=np.float32)
        if not len(triangles):
            return reflectance, emission, transmittance
        looks = self._triangle_looks[triangles]
        order = np.argsort(looks, kind="stable")
        present, starts = np.unique(looks[order], return_index=True)
        for look, points in zip(present, np.split(order, starts[1:]), strict=True):
            if look < 0:
                continue
            for start in range(0, len(points), CHUNK):
                part = points[start : start + CHUNK]
                values = self._at(look, self._triangle_rows[triangles[part]], barycentric[part])
                reflectance[part], emission[part], transmittance[part] = values
        return reflectance, emission, transmittance

    def means(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """For each look, mean reflectance (t, 3), emission (t, 3) and transmittance (t,) of the rows of its pool."""
        return [self._mean(look) for look in range(len(self._looks))]

    def _at(self, look: int, rows: np.ndarray, barycentric: np.ndarray):
        weights = np.asarray(barycentric, dtype=np.float32)
        attributes = {key: np.einsum("nc,nck->nk", weights, pool[rows]) for key, pool in self._pools[look].items()}
        return evaluate(self._looks[look], attributes, len(rows))

    def _mean(self, look: int):
        count = len(next(iter(self._pools[look].values())))
        samples = int(np.clip(SAMPLE_BUDGET // max(count, 1), LEAST_SAMPLES, MOST_SAMPLES))
        weights = _triangle_points(samples)
        sums = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
        step = max(1, CHUNK // samples)
        for start in range(0, count, step):
            rows = np.arange(start, min(start + step, count))
            values = self._at(look, np.repeat(rows, samples), np.tile(weights, (len(rows), 1)))
            for total, value in zip(sums, values, strict=True):
                total[rows] = value.reshape(len(rows), samples, *value.shape[1:]).mean(1)
        return sums


def _triangle_points(count: int) -> np.ndarray:
    """(count, 3) barycentric weights spread evenly over a triangle, the same for every triangle.

    The R2 sequence (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences"), folded at the diagonal.
    """
    plastic = 1.32471795724474602596  # the real root of x^3 = x + 1
    points = (0.5 + np.arange(1, count + 1)[:, None] / [plastic, plastic**2]) % 1
    points = np.where(points.sum(1, keepdims=True) > 1, 1 - points, points)
    return np.column_stack([1 - points.sum(1), points])
