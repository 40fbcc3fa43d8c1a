"""GMRES: bright rooms in few products, restarts, and what it must not do."""

import numpy as np
import pytest
from radiosity import core

from tests.core.solvers.systems import random_system


def two_rooms(count=60, door=0.01):
    """Two integrating spheres of `count` patches each that see each other through a door."""
    half = np.full((count, count), 1 / count)
    return np.block([[(1 - door) * half, door * half], [door * half, (1 - door) * half]])


@pytest.mark.parametrize("reflectance", [0.5, 0.9, 0.999, 0.999999])
def test_bright_rooms_take_hardly_more_than_dark_ones(reflectance):
    matrix, _, emission, areas = random_system(1)
    # Rounding of the radiosity, which is 1 / (1 - reflectance) times the emission, is the floor of the residual.
    tolerance = 1e-14 / (1 - reflectance)
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, "gmres", tolerance=tolerance)
    assert solution.converged and solution.iterations <= 15
    direct = core.solve_radiosity(matrix, reflectance, emission, areas).radiosity
    # An error of the residual's size in the sum over all patches, times 40 for a single one.
    np.testing.assert_allclose(solution.radiosity, direct, rtol=40 * tolerance / (1 - reflectance))


def test_rooms_behind_a_door_are_two_directions():
    # Jacobi and Gauss-Seidel need thousands of sweeps; here all light lives in three directions.
    emission = np.zeros(120)
    emission[0] = 1
    solution = core.solve_radiosity(two_rooms(), 0.999, emission, method="gmres", tolerance=1e-10)
    assert solution.iterations <= 3
    slow = core.solve_radiosity(two_rooms(), 0.999, emission, method="gauss_seidel", max_iterations=200)
    assert not slow.converged
    np.testing.assert_allclose(
        solution.radiosity, core.solve_radiosity(two_rooms(), 0.999, emission).radiosity, rtol=1e-9
    )


@pytest.mark.parametrize("restart", [1, 2, 5])
def test_restarts_reach_the_solution(restart):
    matrix, reflectance, emission, areas = random_system(2)
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, "gmres", tolerance=1e-12, restart=restart)
    assert solution.converged and solution.iterations > restart
    direct = core.solve_radiosity(matrix, reflectance, emission, areas).radiosity
    np.testing.assert_allclose(solution.radiosity, direct, rtol=1e-10)


def test_no_reciprocity_is_needed():
    generator = np.random.default_rng(3)
    matrix = generator.random((50, 50)) / 50
    emission = generator.random((50, 3))
    solution = core.solve_radiosity(matrix, 0.9, emission, method="gmres", tolerance=1e-12)
    np.testing.assert_allclose(solution.radiosity, core.solve_radiosity(matrix, 0.9, emission).radiosity, rtol=1e-10)


def test_residual_falls_at_each_step_in_its_own_norm():
    matrix, reflectance, emission, areas = random_system(4)
    norms = []

    def record(state):
        unshot = emission + reflectance * (matrix @ state.radiosity) - state.radiosity
        np.testing.assert_allclose(state.unshot, unshot, atol=1e-13)
        norms.append(np.sqrt(areas @ unshot**2))

    core.solve_radiosity(matrix, reflectance, emission, areas, "gmres", tolerance=1e-10, callback=record)
    assert np.all(np.diff(norms, axis=0) < 1e-15)


def test_no_radiosity_is_negative_however_early_it_stops():
    generator = np.random.default_rng(5)
    count = 60
    # A row of patches that each see only their neighbors: far ones are still dark when it stops.
    matrix = 0.5 * (np.eye(count, k=1) + np.eye(count, k=-1))
    emission = np.where(np.arange(count) == 3, 1.0, 0.0)
    for stop in range(1, 12):
        solution = core.solve_radiosity(matrix, generator.uniform(0.2, 0.9), emission, method="gmres",
                                        tolerance=1e-4, max_iterations=stop)  # fmt: skip
        assert solution.radiosity.min() >= 0
        assert solution.converged == (solution.residual <= 1e-4)


def test_patches_without_area_keep_their_emission():
    matrix, reflectance, emission, areas = random_system(6)
    matrix[7], matrix[:, 7], areas[7] = 0, 0, 0
    solution = core.solve_radiosity(matrix, reflectance, emission, areas, "gmres", tolerance=1e-12)
    np.testing.assert_allclose(solution.radiosity[7], emission[7], rtol=1e-12)
