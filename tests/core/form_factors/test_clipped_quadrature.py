"""Form factors with occlusion by exact clipping, against published values to their last digits."""

import tracemalloc

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors import clipped_quadrature
from radiosity.core.form_factors.contour_integral import contour_rows

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, polygons_of, surface_matrix

CASES = form_factor_cases()
OBSTRUCTED = ids(CASES, "obstructed")
ENCLOSURES = ("enc-facet-8", "enc-L-room", "enc-two-sealed-cubes")
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
UP = np.array([0.0, 0, 1])
ABOVE = SQUARE[::-1] + UP


def pair_values(case, **choices):
    surfaces = {surface["name"]: surface["polygons"] for surface in case["surfaces"]}
    for expected in case["expected"]:
        ends = (expected["from"], expected["to"])
        blockers = [polygon for name, polygons in surfaces.items() if name not in ends for polygon in polygons]
        yield core.form_factor(*(surfaces[end][0] for end in ends), blockers, **choices), expected["F"]


@pytest.mark.parametrize("name", OBSTRUCTED)
def test_obstructed_pair_at_the_exact_level(name):
    # obs-grazing-none asks for 2e-8, all others for 2e-6 or zero.
    accuracy = 1e-8 if name == "obs-grazing-none" else 1e-6
    for value, expected in pair_values(CASES[name], visibility="bsp", accuracy=accuracy):
        assert abs(value - expected) <= allowed(CASES[name], "exact", expected)


@pytest.mark.parametrize("name", ENCLOSURES)
def test_enclosure_at_the_exact_level(name):
    case = CASES[name]
    order, expected = case["matrix"]["order"], np.array(case["matrix"]["F"])
    choices = {"method": "point_to_polygon", "visibility": "bsp"}
    sealed = name == "enc-two-sealed-cubes"
    matrix, _, result = surface_matrix(case, accuracy=1e-8 if sealed else 1e-6, **choices)
    assert (np.abs(in_order(case, matrix, order) - expected) <= allowed(case, "exact", expected)).all()
    assert result.closed and not in_order(case, matrix, order)[expected == 0].any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["enc-box345-1cube", "enc-cornell"])
def test_large_enclosure_at_the_fine_level(name):
    case = CASES[name]
    order, expected = case["matrix"]["order"], np.array(case["matrix"]["F"])
    matrix, _, _ = surface_matrix(case, method="point_to_polygon", visibility="bsp", accuracy=1e-4)
    error = np.abs(in_order(case, matrix, order) - expected)
    assert (error <= allowed(case, "fine", expected)).all() and error.max() <= 1e-4


@pytest.mark.slow
def test_cornell_box_at_the_exact_level():
    case = CASES["enc-cornell"]
    order, expected = case["matrix"]["order"], np.array(case["matrix"]["F"])
    matrix, _, _ = surface_matrix(case, method="point_to_polygon", visibility="bsp", accuracy=1e-6)
    assert (np.abs(in_order(case, matrix, order) - expected) <= allowed(case, "exact", expected)).all()


def short_box():
    """Wall, a thin floor triangle behind the short box, and one before its side by a tip alone; then the box."""
    polygons, owners = polygons_of(CASES["enc-cornell"])
    names = np.array([surface["name"] for surface in CASES["enc-cornell"]["surfaces"]])[owners]
    wall = polygons[names.tolist().index("right-green")]
    box = [polygon for polygon, name in zip(polygons, names, strict=True) if name.startswith("short")]
    return wall, polygons[4], polygons[1], box


def test_a_tip_that_alone_sees_the_source_counts():
    # A thousandth of the triangle lies before the box's side, and planes of the box cross it where nothing is seen.
    _, _, floor, box = short_box()
    *others, side = box
    exact = core.form_factor(floor, side, method="contour_integral")
    assert 0 < exact < 2e-5
    assert core.form_factor(floor, side, others, visibility="bsp", accuracy=1e-8) == pytest.approx(exact, abs=1e-8)


def test_a_corner_that_sees_past_a_box_counts():
    # From the wall most points see nothing of the thin triangle behind the box, whatever the accuracy; from the
    # triangle few do. Both ways must agree, as each is exact.
    wall, strip, _, box = short_box()
    environment = core.Environment.from_polygons([wall, strip, *box])
    ratio = environment.areas[1] / environment.areas[0]
    quadrature = clipped_quadrature.ClippedQuadrature(environment)
    values, errors = quadrature.pairs([0, 1], [1, 0], np.array([1e-7 * ratio, 1e-7]))
    assert values[0] == pytest.approx(values[1] * ratio, abs=2e-7 * ratio)
    assert (errors <= [1e-7 * ratio, 1e-7]).all()


#: Pairs of the Cornell box whose stated error was exceeded when only changes by divisions were counted, or when small
#: contributions were not looked at again: a thin floor triangle and whatever sees it, and others.
HARD = [(3, 14), (3, 16), (3, 25), (4, 16), (5, 16), (15, 3), (20, 6), (10, 18), (12, 14), (24, 7), (26, 0), (20, 26)]


@pytest.mark.parametrize("accuracy", [1e-3, 1e-4, 1e-5])
def test_stated_error_holds_in_either_direction(accuracy):
    polygons, _ = polygons_of(CASES["enc-cornell"])
    environment = core.Environment.from_polygons(polygons)
    quadrature = clipped_quadrature.ClippedQuadrature(environment)
    first, second = np.array(HARD).T
    areas = environment.areas
    swap = areas[first] > areas[second]
    small, large = np.where(swap, second, first), np.where(swap, first, second)
    exact, _ = quadrature.pairs(small, large, np.full(len(small), 1e-7))
    for here, there, scale in ((small, large, 1.0), (large, small, areas[small] / areas[large])):
        values, errors = quadrature.pairs(here, there, np.full(len(here), accuracy))
        assert (np.abs(values - exact * scale) <= errors + 1e-7 * scale).all() and errors.max() <= accuracy


def test_what_nothing_can_block_is_exact_whatever_the_accuracy():
    # A box's side and a floor triangle at its foot share an edge: points on either see a jump there.
    polygons, _ = polygons_of(CASES["enc-cornell"])
    environment = core.Environment.from_polygons(polygons)
    quadrature = clipped_quadrature.ClippedQuadrature(environment)
    exact = contour_rows(environment).matrix
    for here, there in ((31, 3), (3, 31), (31, 8), (20, 9)):
        values, errors = quadrature.pairs([here], [there], np.array([1e-3]))
        assert values[0] == pytest.approx(exact[here, there], abs=1e-5) and errors[0] <= 2e-5


@pytest.mark.parametrize("name", ["enc-box345-1cube", "enc-facet-8"])
def test_blocks_of_memory_do_not_change_factors(name, monkeypatch):
    environment = core.Environment.from_polygons(polygons_of(CASES[name])[0])
    whole = clipped_quadrature.clipped_rows(environment, "bsp", 1e-3)
    monkeypatch.setattr(clipped_quadrature, "MOST_ACTIVE", 4)
    monkeypatch.setattr(clipped_quadrature, "MOST_CANDIDATES", 100)
    monkeypatch.setattr(clipped_quadrature, "BLOCK_VIEWS", 50)
    parts = clipped_quadrature.clipped_rows(environment, "bsp", 1e-3)
    np.testing.assert_allclose(parts.matrix, whole.matrix, rtol=0, atol=1e-13)
    np.testing.assert_allclose(parts.errors, whole.errors, rtol=0, atol=1e-13)


def furnished(count):
    """A room with boxes in the air, and a scene of 6 + 6 x count polygons."""
    unit = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    generator = np.random.default_rng(0)
    boxes = [(np.zeros(3), np.array([4.0, 3, 2.5]), True)]
    for place in range(count):
        low = np.array([place % 4 + 0.2, place // 4 + 0.2, 0.1 + 0.5 * generator.random()])
        boxes.append((low, low + 0.3 + 0.3 * generator.random(3), False))
    polygons = []
    for low, high, inward in boxes:
        for axis in range(3):
            for side in (0.0, 1.0):
                loop = np.empty((4, 3))
                loop[:, axis], loop[:, [(axis + 1) % 3, (axis + 2) % 3]] = side, unit
                polygons.append(low + (loop[::-1] if (side == 0) != inward else loop) * (high - low))
    return core.Environment.from_polygons(polygons)


def test_memory_does_not_grow_with_pairs():
    # 42 polygons have 861 pairs. With lines of every corner and edge for all of them it was 1.4 GB; now it is 49 MB.
    environment = furnished(6)
    tracemalloc.start()
    rows = clipped_quadrature.clipped_rows(environment, "bsp", 2e-2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= 100e6
    # The room is closed: its own rows tell how good the factors are.
    assert np.abs(rows.matrix.sum(axis=1) - 1).max() <= 2e-2 and rows.matrix.min() >= 0


def test_half_of_a_light_behind_a_wall_is_half_of_its_factor():
    wall = np.array([[0.5, -5, 0.001], [5, -5, 0.001], [5, 5, 0.001], [0.5, 5, 0.001]])
    free = core.configuration_factor([0.5, 0.5, 0], [0, 0, 1], ABOVE)
    half = core.configuration_factor([0.5, 0.5, 0], [0, 0, 1], ABOVE, blockers=[wall], visibility="bsp")
    assert half == pytest.approx(free / 2, rel=1e-12)


@pytest.mark.parametrize("scale, shift", [(1e-5, 0), (1e5, 0), (1, 1e4)])
def test_scale_and_place_do_not_matter(scale, shift):
    plate = np.array([[0.1, 0.2, 0.4], [0.7, 0.1, 0.6], [0.6, 0.9, 0.5]])
    here = core.form_factor(SQUARE, ABOVE, [plate], visibility="bsp", accuracy=1e-5)
    there = (polygon * scale + shift for polygon in (SQUARE, ABOVE, plate))
    a, b, blocker = there
    # Coordinates that far away are rounded to 2e-12 of the size.
    assert core.form_factor(a, b, [blocker], visibility="bsp", accuracy=1e-5) == pytest.approx(here, abs=1e-5)


def test_a_two_sided_patch_gives_half_to_either_side():
    environment = core.Environment.from_polygons([SQUARE, ABOVE], two_sided=[True, False])
    one_sided = core.form_factor(SQUARE, ABOVE, accuracy=1e-6)
    rows = clipped_quadrature.clipped_rows(environment, "bsp", 1e-6)
    assert rows.matrix[0, 1] == pytest.approx(one_sided / 2, abs=1e-6)
    assert rows.matrix[1, 0] == pytest.approx(one_sided, abs=1e-6)


def test_stated_error_holds_and_falls_with_the_accuracy():
    case = CASES["obs-tilted-quad"]
    for accuracy in (1e-3, 1e-4, 1e-5):
        for value, expected in pair_values(case, visibility="bsp", accuracy=accuracy):
            assert abs(value - expected) <= accuracy


def test_clipping_is_refused_where_it_does_not_exist():
    with pytest.raises(SettingsError, match="does not exist for hemisphere"):
        core.form_factor(SQUARE, ABOVE, method="hemisphere", visibility="bsp")
    with pytest.raises(SettingsError, match="Unknown visibility"):
        core.form_factor(SQUARE, ABOVE, visibility="guess")
