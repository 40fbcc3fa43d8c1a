"""Radiosity systems that tests of solvers share."""

import numpy as np
from radiosity.core.form_factors.identities import close_rows


def random_system(seed, count=40, channels=3, closed=True):
    """Reciprocal factors of an invented scene, with reflectance, emission and areas."""
    generator = np.random.default_rng(seed)
    areas = generator.uniform(0.2, 1, count)
    exchange = np.outer(areas, areas) * generator.random((count, count))
    exchange = close_rows(exchange + exchange.T, areas) / areas[:, None]
    matrix = exchange if closed else 0.7 * exchange
    return matrix, generator.uniform(0, 0.9, (count, channels)), generator.random((count, channels)) ** 8, areas
