"""Radiosity systems that tests of solvers share."""

import numpy as np


def random_system(seed, count=40, channels=3, closed=True):
    """Reciprocal factors of an invented scene, with reflectance, emission and areas."""
    generator = np.random.default_rng(seed)
    sizes = generator.uniform(0.2, 1, count)
    exchange = np.outer(sizes, sizes) * generator.random((count, count))
    exchange += exchange.T
    # A patch as large as what it exchanges sends everything to others.
    areas = exchange.sum(axis=1)
    matrix = exchange / areas[:, None] * (1 if closed else 0.7)
    return matrix, generator.uniform(0, 0.9, (count, channels)), generator.random((count, channels)) ** 8, areas
