"""Any kernel with any visibility: each pair of names meets a published value, or is refused with the reason."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.matrix import METHODS
from radiosity.core.visibility.segments import VISIBILITIES

from tests.reference_cases import form_factor_cases, surface_matrix

CASE = form_factor_cases()["obs-centre-mid"]
#: The z-buffer adds half a pixel along the shadow's border, and each point needs one of its own.
ACCURACY = {"zbuffer": 2e-2}
DEFAULT_ACCURACY = 4e-3
#: Why a pair is refused, by the sense of its text.
REFUSED = {
    "hemisphere": "meets first",
    "hemicube": "item buffer",
    "single_plane": "item buffer",
    "hybrid": "contour_integral is the same",
}


def test_every_visibility_is_known_to_some_method():
    assert {name for method in METHODS.values() for name in method.visibilities} == set(VISIBILITIES)


@pytest.mark.parametrize("visibility", VISIBILITIES)
@pytest.mark.parametrize("method", METHODS)
def test_two_plates_with_a_blocker_or_a_reason(method, visibility):
    accuracy = ACCURACY.get(visibility, DEFAULT_ACCURACY)
    choices = {"method": method, "visibility": visibility, "accuracy": accuracy}
    if visibility not in METHODS[method].visibilities:
        with pytest.raises(SettingsError, match=f"does not exist for {method}, as .*{REFUSED[method]}.*choose auto"):
            surface_matrix(CASE, **choices)
        return
    matrix, _, result = surface_matrix(CASE, **choices)
    names = [surface["name"] for surface in CASE["surfaces"]]
    for expected in CASE["expected"]:
        pair = names.index(expected["from"]), names.index(expected["to"])
        wanted = expected["F"]
        if visibility == "none":
            plates = [CASE["surfaces"][row]["polygons"][0] for row in pair]
            wanted = core.form_factor(*plates, method="contour_integral")
        assert matrix[pair] == pytest.approx(wanted, abs=accuracy)
    assert (result.matrix >= 0).all() and (result.matrix <= 1).all() and np.isfinite(result.matrix).all()


@pytest.mark.parametrize("visibility", ["embree", "bsp", "silhouettes", "brute_force"])
@pytest.mark.parametrize("method", ["contour_integral", "disk", "hybrid"])
def test_a_single_pair_takes_the_same(method, visibility):
    surfaces = {surface["name"]: surface["polygons"][0] for surface in CASE["surfaces"]}
    expected = CASE["expected"][0]
    ends = expected["from"], expected["to"]
    blockers = [polygon for name, polygon in surfaces.items() if name not in ends]
    value = core.form_factor(
        *(surfaces[end] for end in ends), blockers, method=method, visibility=visibility, accuracy=DEFAULT_ACCURACY
    )
    assert value == pytest.approx(expected["F"], abs=DEFAULT_ACCURACY)


def test_a_single_pair_is_refused_with_the_reason():
    plates = [surface["polygons"][0] for surface in CASE["surfaces"]]
    for method, visibility, reason in (
        ("hemicube", "embree", "item buffer"),
        ("hybrid", "none", "contour_integral is the same"),
        ("point_to_polygon", "zbuffer", "casts rays or clips"),
    ):
        with pytest.raises(SettingsError, match=f"does not exist for {method}.*{reason}"):
            core.form_factor(*plates[:2], plates[2:], method=method, visibility=visibility)


def test_a_visibility_that_nobody_knows_is_refused_by_all():
    for method in METHODS:
        with pytest.raises(SettingsError, match=r"Visibility 'magic' does not exist for .*: choose auto"):
            surface_matrix(CASE, method=method, visibility="magic")
