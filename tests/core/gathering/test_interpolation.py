"""Interpolation from nodes, and filling from neighbors."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.discretization.nodes import build_levels
from radiosity.core.gathering.interpolation import OVERSHOOT, fill_from_neighbors, interpolate
from radiosity.core.gathering.receivers import build_receivers
from radiosity.core.visibility.embree import Frame, RayPool

from tests.bakes import Thing, receiver_of
from tests.scenes import grid, inward_sphere

SQUARE = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]


def level_over(mesh, spacing=0.1):
    receivers = build_receivers([mesh], Frame.around(mesh.positions))
    (level,) = build_levels(receivers.points, receivers.normals, receivers.edges, spacing, 1)
    return receivers, level


PLANE = level_over(receiver_of(Thing(*grid(SQUARE, 60, 60))))
SPHERE = level_over(inward_sphere(30).receivers[0])


def run(setup, values, valid=None, threads=1):
    receivers, level = setup
    valid = np.ones(len(level.nodes), bool) if valid is None else valid
    with RayPool(threads) as pool:
        return interpolate(
            receivers.points,
            receivers.normals,
            np.arange(len(receivers)),
            level.clusters,
            level,
            values.astype(np.float32),
            valid,
            pool,
        )


@pytest.mark.parametrize("setup", [PLANE, SPHERE], ids=["plane", "sphere"])
def test_constants_are_kept(setup):
    values, found = run(setup, np.tile([0.0, 1.0, 1e6], (len(setup[1].nodes), 1)))
    assert found.all()
    np.testing.assert_allclose(values, np.tile([0.0, 1.0, 1e6], (len(values), 1)), rtol=1e-5)


def test_linear_change_is_met_but_for_the_tie_on_slopes():
    receivers, level = PLANE
    light = (2 + receivers.points @ np.array([[1.0, 0, 1], [0, 1, -1], [0, 0, 0]], np.float32)).astype(np.float32)
    values, _ = run(PLANE, light[level.nodes])
    inner = (np.abs(receivers.points[:, :2]) < 0.4).all(axis=1)
    # The tie shortens slopes by RIDGE over the nodes' own spread, 2 % of about 1 spacing squared.
    np.testing.assert_allclose(values[inner], light[inner], atol=0.05 * 0.1)
    # At the rim the nodes lie to one side: their mean, half a spacing away at most, is the least the fit can give, with
    # no slope at all. The third channel rises by the square root of 2.
    assert (np.abs(values - light).max(axis=0) < 0.5 * 0.1 * np.array([1, 1, np.sqrt(2)])).all()


def test_smooth_change_is_met_to_second_order():
    receivers, _ = PLANE
    light = np.repeat(1 + 0.5 * np.sin(4 * receivers.points[:, :1]) * np.cos(3 * receivers.points[:, 1:2]), 3, axis=1)
    errors = []
    for spacing in (0.2, 0.1, 0.05):
        setup = level_over(receiver_of(Thing(*grid(SQUARE, 60, 60))), spacing)
        values, _ = run(setup, light[setup[1].nodes])
        errors.append(np.sqrt(((values - light) ** 2).mean()))
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_noise_of_single_nodes_is_damped():
    generator = np.random.default_rng(0)
    values, _ = run(PLANE, 10 + generator.normal(size=(len(PLANE[1].nodes), 3)))
    inner = (np.abs(PLANE[0].points[:, :2]) < 0.4).all(axis=1)
    # Some five nodes share in each value: the standard deviation falls to well below 0.8 and the mean stays.
    assert values[inner].std() < 0.75
    assert values[inner].mean() == pytest.approx(10, abs=0.3)


@pytest.mark.parametrize("setup", [PLANE, SPHERE], ids=["plane", "sphere"])
def test_values_stay_within_reach_of_their_nodes_and_never_fall_below_zero(setup):
    generator = np.random.default_rng(1)
    given = generator.exponential(size=(len(setup[1].nodes), 3)) ** 3
    values, _ = run(setup, given)
    level = setup[1]
    around = np.concatenate([np.arange(len(level.nodes))[:, None], level.neighbors], axis=1)
    low, high = given[around].min(axis=1), given[around].max(axis=1)
    room = OVERSHOOT * (high - low)
    assert values.min() >= 0
    assert (values <= (high + room)[level.clusters] * (1 + 1e-5)).all()
    assert (values >= (low - room)[level.clusters] - 1e-5 * high[level.clusters]).all()


def test_values_of_invalid_nodes_are_never_used():
    generator = np.random.default_rng(2)
    valid = generator.random(len(PLANE[1].nodes)) < 0.7
    given = np.where(valid[:, None], 1.0, 1e9)
    values, found = run(PLANE, given, valid)
    np.testing.assert_allclose(values[found], 1, rtol=1e-4)
    np.testing.assert_array_equal(values[~found], 0)


def test_nothing_valid_is_said():
    values, found = run(PLANE, np.ones((len(PLANE[1].nodes), 3)), np.zeros(len(PLANE[1].nodes), bool))
    assert not found.any() and not values.any()


def test_nodes_across_a_cut_have_no_part():
    receivers = PLANE[0]
    side = receivers.points[:, 0] > 0.013
    edges = receivers.edges[side[receivers.edges[:, 0]] == side[receivers.edges[:, 1]]]
    (level,) = build_levels(receivers.points, receivers.normals, edges, 0.1, 1)
    values, _ = run((receivers, level), np.repeat(side[level.nodes, None] * 7.0, 3, axis=1))
    np.testing.assert_allclose(values[:, 0], 7.0 * side, atol=1e-5)


def test_threads_do_not_change_a_bit():
    given = np.random.default_rng(3).random((len(SPHERE[1].nodes), 3))
    np.testing.assert_array_equal(run(SPHERE, given, threads=1)[0], run(SPHERE, given, threads=8)[0])


# --- filling ----------------------------------------------------------------------------------------------------------

CHAIN = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5]])


def test_filling_goes_ring_by_ring():
    values = np.array([[1.0], [9], [9], [9], [9], [3.0]])
    known = np.array([True, False, False, False, False, True])
    filled, reached = fill_from_neighbors(values, known, CHAIN, 1)
    np.testing.assert_array_equal(filled[:, 0], [1, 1, 9, 9, 3, 3])
    np.testing.assert_array_equal(reached, [True, True, False, False, True, True])
    filled, reached = fill_from_neighbors(values, known, CHAIN, 64)
    np.testing.assert_array_equal(filled[:, 0], [1, 1, 1, 3, 3, 3])
    assert reached.all()


def test_filling_takes_the_mean_of_all_known_neighbors():
    star = np.array([[0, 1], [2, 0], [0, 3]])
    filled, _ = fill_from_neighbors(np.array([[0.0], [1], [2], [6]]), np.arange(4) > 0, star, 1)
    assert filled[0, 0] == 3


def test_known_values_and_the_given_array_stay_and_the_unreachable_too():
    values = np.array([[1.0], [5], [7], [7], [7], [7]])
    known = np.array([True, False, False, False, False, False])
    filled, reached = fill_from_neighbors(values, known, CHAIN[:1], 64)
    np.testing.assert_array_equal(filled[:, 0], [1, 1, 7, 7, 7, 7])
    np.testing.assert_array_equal(values[:, 0], [1, 5, 7, 7, 7, 7])
    np.testing.assert_array_equal(reached, [True, True, False, False, False, False])
    same, _ = fill_from_neighbors(values, np.ones(6, bool), CHAIN, 64)
    np.testing.assert_array_equal(same, values)


def test_filling_without_edges():
    filled, reached = fill_from_neighbors(np.ones((2, 3)), np.zeros(2, bool), np.empty((0, 2), int), 5)
    assert not reached.any() and (filled == 1).all()


def test_a_level_of_one_node_gives_its_value():
    receivers, level = level_over(receiver_of(Thing(*grid(SQUARE, 1, 1))), 4.0)
    level = replace(level)
    values, found = run((receivers, level), np.arange(3 * len(level.nodes), dtype=float).reshape(-1, 3))
    assert found.all() and np.isfinite(values).all()
