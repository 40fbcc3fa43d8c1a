"""Single pairs and points by cropped hemicubes: published values, near, far, small, hidden."""

import numpy as np
import pytest
from radiosity import core

from tests.reference_cases import allowed, form_factor_cases, ids

CASES = form_factor_cases()
#: Of extreme aspect: hits are too rare for the limit of points, which is logged.
HARD = ("ext-sliver-1e-6-far",)
#: Infinitely many points lie next to the singular line, or polygons cross: seconds.
SLOW = ("ext-crossing", "ext-half-edge", "ff-perp-1-1-10", "ff-perpns-4-4", "ff-perp-3-0.5-2", "obs-perp-plate")
PAIRS = [
    pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
    for name in ids(CASES, "polygon-polygon", "extreme", "obstructed")
    if name not in HARD
]


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_at_the_fine_level(name):
    case = CASES[name]
    polygons = {surface["name"]: surface["polygons"] for surface in case["surfaces"]}
    expected = case["expected"][0]
    ends = (expected["from"], expected["to"])
    blockers = [loop for key, loops in polygons.items() if key not in ends for loop in loops]
    found = core.form_factor(*(polygons[end][0] for end in ends), blockers, method="hemicube", accuracy=1e-3)
    # Two standard errors are a part of 1e-3 of the factor, which is half of this.
    assert abs(found - expected["F"]) <= allowed(case, "fine", expected["F"])


@pytest.mark.parametrize("name", ["el-b3-1-1-1", "el-triangle", "el-horizon-tilt", "el-far", "el-pentagon"])
def test_points_at_the_fine_level(name):
    case = CASES[name]
    element, expected = case["elements"][0], case["expected"][0]
    polygon = case["surfaces"][0]["polygons"][0]
    found = core.configuration_factor(element["point"], element["normal"], polygon, method="hemicube", accuracy=1e-3)
    assert abs(found - expected["F"]) <= allowed(case, "fine", expected["F"])


def test_the_relative_error_does_not_depend_on_distance():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    for distance in (1e2, 1e4, 1e6):
        far = square[::-1] + np.array([0, 0, distance])
        found = core.form_factor(square, far, method="hemicube", accuracy=2e-3)
        # Six of the standard errors that the accuracy allows.
        assert found == pytest.approx(1 / (np.pi * distance**2), rel=6e-3)
