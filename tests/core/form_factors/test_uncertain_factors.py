"""Factors computed anew: what is drawn for them, what the others become, and blocks that do not grow with the rows."""

import tracemalloc

import numpy as np
import pytest
from radiosity import core
from radiosity.core.form_factors import projection
from radiosity.core.form_factors.hemicube import hemicubes
from radiosity.core.form_factors.projection import ProjectedRows
from radiosity.core.form_factors.single_plane import single_planes
from radiosity.core.form_factors.uncertain_factors import rebalanced, uncertain

from tests.scenes import cornell_box

ACCURACY = 1e-2


def blocks_in_a_room(divisions: int) -> core.Environment:
    receiver = cornell_box(divisions).receivers[0]
    return core.Environment.from_polygons([receiver.positions[q] for q in receiver.corner_vertices.reshape(-1, 4)])


@pytest.mark.parametrize("cameras", [hemicubes(), single_planes(ACCURACY)], ids=["hemicube", "single_plane"])
def test_what_is_drawn_for_some_factors_suffices_for_them(cameras):
    environment = blocks_in_a_room(4)
    rows = np.arange(len(environment))
    scene = ProjectedRows(environment, cameras)
    everything, _, errors, _ = scene._sample(rows, 2, (0, 0))
    wanted = uncertain(errors, ACCURACY)
    # Some of each row's patches at random, too: far ones, with blocks in between.
    wanted |= np.random.default_rng(0).random(wanted.shape) < 0.02
    drawn = scene.between(rows, wanted)
    assert not (wanted & ~drawn).any()
    assert drawn.mean() < 0.8
    some = scene._sample(rows, 2, (0, 0), wanted)[0]
    # The same pixels but for the order of sums, far below what one pixel more or less is.
    np.testing.assert_allclose(some, everything * wanted, rtol=0, atol=1e-12)


def test_the_rest_of_a_row_takes_what_better_factors_leave():
    first = np.array([[0.4, 0.3, 0.2, 0.1]] * 3)
    anew = np.array([[True, False, False, False]] * 3)
    better = first + np.array([0.006, 0, 0, 0])
    escaped = np.array([0.0, 0.2, 0.05])
    factors, left = rebalanced(better, first, escaped, anew, lost=0.0)
    np.testing.assert_allclose(factors[:, 0], 0.406, rtol=0, atol=0)
    # Closed: the others shrink by 0.006 / 0.6. What escapes has its part of that.
    np.testing.assert_allclose(factors[0, 1:], first[0, 1:] * 0.99, rtol=1e-12)
    np.testing.assert_allclose(factors[1, 1:], first[1, 1:] * (1 - 0.006 / 0.8), rtol=1e-12)
    np.testing.assert_allclose(factors.sum(axis=1) + left, 1 + escaped, rtol=1e-12)
    assert left[0] == 0
    # What is lost beside a camera is no part of the rest.
    factors, left = rebalanced(better[2:], first[2:], escaped[2:], anew[2:], lost=0.05)
    np.testing.assert_allclose(factors[0, 1:], first[2, 1:] * 0.99, rtol=1e-12)
    assert left[0] == 0.05


def test_the_rest_vanishes_where_better_factors_leave_nothing_and_stays_nothing():
    first = np.array([[0.9, 0.1, 0, 0], [0.5, 0.5, 0, 0]])
    anew = np.array([[True, False, False, False], [True, True, False, False]])
    better = first + np.array([[0.2, 0, 0, 0], [0.1, 0.1, 0, 0]])
    factors, escaped = rebalanced(better, first, np.zeros(2), anew, lost=0.0)
    np.testing.assert_array_equal(factors, [[1.1, 0, 0, 0], [0.6, 0.6, 0, 0]])
    np.testing.assert_array_equal(escaped, 0)


@pytest.mark.parametrize("accuracy", [1e-2, 3e-3])
def test_rows_sum_to_one_where_factors_are_computed_anew(accuracy):
    environment = blocks_in_a_room(6)
    rows = np.arange(len(environment))
    factors, escaped, errors, _ = ProjectedRows(environment, hemicubes(16)).refined(rows, accuracy, 0)
    assert errors.max() <= accuracy
    # The pixels' shares sum to 1 to some rounding: nothing of it may get lost where factors are computed anew.
    np.testing.assert_allclose(factors.sum(axis=1) + escaped, 1, rtol=0, atol=1e-12)


class LuckyRepetitions(ProjectedRows):
    """Repetitions that at first agree on what is wrong of two patches of three."""

    FIRST = np.array([[0, 0.2, 0.5, 0.3]])
    TRUE = np.array([[0, 0.6, 0.2, 0.2]])

    def _sample(self, rows, level, seed, wanted=None):
        many = np.array([10**9])
        if wanted is None:
            return self.FIRST.copy(), np.zeros(1), np.array([[0, 0.1, 0, 0]]), many
        return self.TRUE * wanted, np.zeros(1), np.zeros((1, 4)), many


def test_factors_that_agree_by_luck_are_found_out_by_the_sum():
    receiver = cornell_box(4).receivers[0]
    quads = receiver.corner_vertices.reshape(-1, 4)[:4]
    environment = core.Environment.from_polygons([receiver.positions[q] for q in quads])
    factors, escaped, errors, _ = LuckyRepetitions(environment, hemicubes(8)).refined(np.arange(1), ACCURACY, 0)
    np.testing.assert_array_equal(factors, LuckyRepetitions.TRUE)
    assert escaped[0] == 0
    assert errors[0] <= ACCURACY


def test_memory_grows_by_the_result_alone(monkeypatch):
    environment = blocks_in_a_room(4)
    monkeypatch.setattr(projection, "BLOCK_PIXELS", 2**14)
    monkeypatch.setattr(projection, "BLOCK_ENTRIES", 16 * len(environment))
    scene = ProjectedRows(environment, hemicubes(8))

    def peak(rows):
        tracemalloc.start()
        scene.refined(rows, 3e-2, 0)
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    rows = np.arange(len(environment))
    most = max(peak(rows[start : start + 16]) for start in range(0, len(rows), 16))
    # The result and 1 % for lists of rows. All rows in one block would take the result's size several times.
    assert peak(rows) < most + 1.01 * len(rows) * len(environment) * 8
