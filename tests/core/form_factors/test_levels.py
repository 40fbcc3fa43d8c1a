"""Methods against all published values: at most one in a hundred off by more than the level allows.

Pair-wise methods, the automatic choice and the hemisphere at both levels; projections at the coarse one, for which
their default is made. What they are left to do is in `docs/form_factors.md`.
"""

import numpy as np
import pytest

from tests.reference_cases import allowed, form_factor_cases, ids, in_order, surface_matrix

CASES = form_factor_cases()

#: Accuracy asked for at each level. Of coarse it could be twice that: 2e-2 of a factor, or 1e-3, are allowed, and
#: 2 / 0.7 standard errors of 5e-3 are 1e-2 and 5e-4.
LEVELS = {"fine": 1e-3, "coarse": 5e-3}
METHODS = ["contour_integral", "point_to_polygon", "hybrid", "auto"]
#: Of whole rows, at their default accuracy.
ROW_METHODS = ["hemicube", "single_plane", "hemisphere"]

#: Contacts, shadows inside of a patch, small and large, near and far: what each of the methods had been worst at.
QUICK = [
    "ff-par-1-1-1",
    "ff-perp-1-2-1",
    "ff-perp-1-1-10",
    "ff-poly-pentagon",
    "ff-ang-1-1-1-30",
    "enc-facet-8",
    "enc-box345-1cube",
    "obs-perp-plate",
    "obs-centre-mid",
    "ext-far-1e2",
    "ext-gap-1e-2",
]
ALL = ids(CASES, "polygon-polygon", "obstructed", "enclosure", "extreme")


def deviations(method, name, level):
    """Deviations of all factors of a case, over what its level allows."""
    case = CASES[name]
    by_default = method in ROW_METHODS and level == "coarse"
    accuracy = {} if by_default else {"accuracy": LEVELS[level]}
    matrix, _, _ = surface_matrix(case, method=method, **accuracy)
    names = [surface["name"] for surface in case["surfaces"]]
    found = []
    for expected in case.get("expected", ()) if "matrix" not in case else ():
        if isinstance(expected["to"], str) and "F" in expected and expected["from"] in names:
            value = matrix[names.index(expected["from"]), names.index(expected["to"])]
            found.append(abs(value - expected["F"]) / max(allowed(case, level, expected["F"]), 1e-300))
    if "matrix" in case:
        wanted = np.array(case["matrix"]["F"])
        difference = np.abs(in_order(case, matrix, case["matrix"]["order"]) - wanted)
        found.extend((difference / allowed(case, level, wanted)).ravel())
    return np.array(found)


def share_outside(method, names, level):
    found = np.concatenate([deviations(method, name, level) for name in names])
    return (found > 1).mean()


@pytest.mark.parametrize(
    ("method", "level"),
    [
        pytest.param(method, level, marks=[pytest.mark.slow] if (method, level) == ("hybrid", "fine") else [])
        for method in METHODS
        for level in LEVELS
    ],
)
def test_one_value_in_a_hundred_is_outside_of_what_is_asked_for(method, level):
    assert share_outside(method, QUICK, level) <= 0.01


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=[pytest.mark.slow] * (name != "auto")) for name in METHODS]
)
def test_one_published_value_in_a_hundred_is_outside(method, level):
    assert share_outside(method, ALL, level) <= 0.01


@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=[pytest.mark.slow] * (name != "hemisphere")) for name in ROW_METHODS]
)
def test_one_published_value_in_a_hundred_is_outside_of_the_coarse_level_by_default(method):
    assert share_outside(method, ALL, "coarse") <= 0.01


@pytest.mark.slow
def test_one_published_value_in_a_hundred_is_outside_of_the_fine_level_by_the_hemisphere():
    assert share_outside("hemisphere", ALL, "fine") <= 0.01


@pytest.mark.parametrize("method", ["auto", "contour_integral", "point_to_polygon"])
@pytest.mark.parametrize("name", ids(CASES, "obstructed"))
def test_no_blocker_is_missed(method, name):
    assert (deviations(method, name, "fine") <= 1).all()
