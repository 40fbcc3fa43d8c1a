"""Rays that count both ways: against the same formulas on dense matrices, sums, symmetry, and light in a pocket."""

import numpy as np
import pytest
from radiosity.core.lights import PointLight
from radiosity.core.solvers import patch_solution, reciprocity
from radiosity.core.solvers.patch_checks import check_patches
from radiosity.core.solvers.reciprocity import MOST, SWEEPS, SeenRows, two_way_factors
from radiosity.core.solvers.sparse_rows import SparseRows, slices_of

from tests.bakes import Thing, scene_of, solved_patches
from tests.core.solvers.test_patch_solution import dense_factors, dense_of
from tests.scenes import box, cornell_box, furnace_box, grid

#: Weights are float32: a row of n of them sums to its own sum within n half steps at most.
FLOAT32 = 1e-6


def drawn(seed, size=60, points=3, rays=40):
    """Batches of patches that see each other by chance, with areas and open ones: patches of few and of many points,
    points that do not count, some that send no rays, and targets that are no patches."""
    generator = np.random.default_rng(seed)
    areas = generator.uniform(0.01, 1, size)
    rows = generator.permutation(size)[:-5]
    batches = []
    for part, each in ((rows[:30], points), (rows[30:], 1)):
        seen = generator.integers(0, size + 9, (len(part) * each, rays)).astype(np.int32)
        kept = generator.random((len(part), each)) < 0.8
        kept[:, 0] |= ~kept.any(axis=1)
        batches.append(SeenRows(part, seen, kept))
    return batches, areas, generator.random(size) < 0.8


def own_shares(batches, size):
    """(m, m) share of each patch's counted rays that meet each patch."""
    out = np.zeros((size, size))
    for batch in batches:
        each = batch.kept.shape[1]
        for number, row in enumerate(batch.rows):
            seen = batch.seen[number * each : (number + 1) * each][batch.kept[number]].ravel()
            out[row] = np.bincount(seen, minlength=size + 9)[:size] / len(seen)
    return out


@pytest.mark.parametrize("block", [reciprocity.BLOCK, 50], ids=["whole", "in-blocks"])
@pytest.mark.parametrize("seed", [0, 1])
def test_factors_are_those_of_dense_matrices(seed, block, monkeypatch):
    monkeypatch.setattr(reciprocity, "BLOCK", block)
    batches, areas, is_open = drawn(seed)
    factors = dense_of(two_way_factors(batches, areas, is_open))
    np.testing.assert_allclose(factors, dense_factors(batches, areas, is_open), rtol=FLOAT32, atol=0)


def test_each_row_sums_to_what_its_own_rays_have_met():
    batches, areas, is_open = drawn(0)
    factors = dense_of(two_way_factors(batches, areas, is_open))
    np.testing.assert_allclose(factors.sum(axis=1), own_shares(batches, len(areas)).sum(axis=1), atol=FLOAT32)


def test_what_is_not_open_keeps_to_its_own_rays():
    batches, areas, is_open = drawn(0)
    own = own_shares(batches, len(areas))
    factors = dense_of(two_way_factors(batches, areas, is_open))
    np.testing.assert_allclose(factors[~is_open], own[~is_open], rtol=FLOAT32)
    np.testing.assert_allclose(factors[:, ~is_open], own[:, ~is_open], rtol=FLOAT32)
    alone = dense_of(two_way_factors(batches, areas, np.zeros_like(is_open)))
    np.testing.assert_allclose(alone, own, rtol=FLOAT32)


@pytest.mark.parametrize("make", [cornell_box, furnace_box], ids=["cornell", "furnace"])
def test_exchange_is_symmetric_but_for_what_the_damping_leaves(make):
    solution, _ = solved_patches(make())
    is_open = ~solution.enclosed
    power = solution.open_areas[:, None] * dense_of(solution.factors)
    power = power[is_open][:, is_open]
    # Whoever hears is heard.
    np.testing.assert_array_equal(power > 0, power.T > 0)
    some = power > 0
    ratio = np.log(power[some] / power.T[some])
    # Each of the sweeps halves what is left of the sums' scatter, that of 128 rays a patch in two estimates: some 7 %
    # between two of them, which three sweeps bring to an eighth; the largest of 100,000 pairs is five times that.
    scatter = 0.08 / 2**SWEEPS
    assert np.sqrt((ratio**2).mean()) < 1.5 * scatter
    assert np.abs(ratio).max() < 8 * scatter
    assert np.abs(power - power.T).sum() < 1.5 * scatter * power.sum()


def test_factors_of_the_scaling_keep_within_their_bounds():
    exchange = SparseRows(2, slices_of(np.array([0, 1]), np.array([1, 0]), np.array([1.0, 1.0])))
    scale, stretch = reciprocity._scaling(exchange, np.array([1e6, 1e-6]), np.ones(2, bool))
    assert (scale <= MOST).all() and (scale >= 1 / MOST).all()
    np.testing.assert_allclose(stretch * exchange.times(scale[:, None])[:, 0], [1e6, 1e-6], rtol=FLOAT32)


def plate_under_lid(gap):
    """A closed white box of side 1, a white plate `gap` under its lid, and a lamp between them."""
    vertices, faces, _ = box(divisions=4)
    height = 1 - gap
    plate = grid([(0.2, 0.2, height), (0.8, 0.2, height), (0.8, 0.8, height), (0.2, 0.8, height)], 4, 4)
    lamp = PointLight(np.array([0.5, 0.5, 1 - gap / 2]), np.ones(3))
    return scene_of(Thing(vertices, faces, 0.95), Thing(*plate, 0.95), lights=[lamp])


@pytest.mark.parametrize("gap", [0.005, 0.01, 0.02])
def test_light_in_a_pocket_is_neither_lost_nor_won(gap, monkeypatch):
    scene = plate_under_lid(gap)

    def balances():
        return [check_patches(solved_patches(scene, 0.03, seed=seed)[0]) for seed in (0, 1)]

    both = balances()
    # Twenty reflections before light is absorbed: as much as the whole bake may err by, in spite of them.
    assert max(found.energy_balance_error for found in both) < 0.01
    assert [found.light_absorbed for found in both] == pytest.approx([1, 1], abs=0.01)
    monkeypatch.setattr(
        patch_solution, "two_way_factors", lambda batches, areas, _: two_way_factors(batches, areas, areas < 0)
    )
    # Each way alone the balance is random, and may be met by chance: the mean square of two seeds counts.
    squares = [np.mean([found.energy_balance_error**2 for found in way]) for way in (balances(), both)]
    assert squares[0] > 3**2 * squares[1]


def test_furnace_stays_exact_on_every_patch():
    solution, _ = solved_patches(furnace_box(reflectance=0.5))
    fronts = solution.radiosity[: solution.patches.count][solution.patches.areas > 0]
    # Of the reflections what the solver leaves undone, 0.002 times the accuracy, and float32.
    np.testing.assert_allclose(fronts, 2, rtol=1e-3)


@pytest.mark.parametrize("columns", [1, 3])
def test_sparse_product_is_the_dense_one(columns):
    generator = np.random.default_rng(0)
    dense = generator.random((300, 300)) * (generator.random((300, 300)) < generator.random((300, 1)) ** 3)
    dense[7] = 0
    rows, at = np.nonzero(dense)
    matrix = SparseRows(300, slices_of(rows, at, dense[rows, at]))
    values = generator.random((300, columns))
    np.testing.assert_allclose(matrix.times(values), dense @ values, rtol=3 * FLOAT32)
    assert not matrix.times(values)[7].any()
    np.testing.assert_allclose(
        dense_of(matrix.reweighted(lambda row, column: row + 2.0 * column)),
        dense * (np.arange(300)[:, None] + 2.0 * np.arange(300)),
        rtol=FLOAT32,
    )


def test_no_entries_make_no_slices():
    nothing = np.empty(0, np.int64)
    assert slices_of(nothing, nothing, np.empty(0)) == []
    assert not SparseRows(3, []).times(np.ones((3, 3))).any()
