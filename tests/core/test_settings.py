"""Settings are checked when made, and the plan follows the accuracy."""

from dataclasses import FrozenInstanceError
from itertools import pairwise

import pytest
from radiosity.core.bake_plan import foreseen_memory, plan_for
from radiosity.core.errors import RadiosityError, SettingsError
from radiosity.core.settings import ACCURACY_RANGE, BAKE_TYPES, METHODS, QUALITY_ACCURACY, SOLVERS, BakeSettings


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"accuracy": 0.0019}, "Accuracy must lie between 0.002 and 0.5, not 0.0019"),
        ({"accuracy": 0.51}, "Accuracy must lie"),
        ({"accuracy": float("nan")}, "Accuracy must lie"),
        ({"accuracy": float("inf")}, "Accuracy must lie"),
        ({"method": "hemicub"}, "Unknown method 'hemicub': choose auto"),
        ({"solver": ""}, "Unknown solver ''"),
        ({"bake_type": "COMBINED"}, "Unknown bake type 'COMBINED': choose combined, lighting"),
        ({"seed": -1}, "Seed must lie between 0 and 2147483647, not -1"),
        ({"seed": 2**31}, "Seed must lie"),
        ({"threads": -1}, "Threads must be 0"),
        ({"time_limit": -1.0}, "Time limit must be 0"),
        ({"time_limit": float("nan")}, "Time limit must be 0"),
        ({"memory_limit": -1.0}, "Memory limit must be 0"),
        ({"memory_limit": float("inf")}, "Memory limit must be 0"),
    ],
)
def test_values_outside_their_range_are_refused_by_name(choice, message):
    with pytest.raises(SettingsError, match=message) as caught:
        BakeSettings(**choice)
    assert isinstance(caught.value, RadiosityError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("accuracy", [*ACCURACY_RANGE, *QUALITY_ACCURACY.values()])
@pytest.mark.parametrize("seed", [0, 2**31 - 1])
def test_bounds_and_presets_are_accepted(accuracy, seed):
    settings = BakeSettings(accuracy=accuracy, seed=seed)
    assert settings.accuracy == accuracy and settings.seed == seed


def test_every_name_is_accepted():
    for method in METHODS:
        for solver in SOLVERS:
            for bake_type in BAKE_TYPES:
                settings = BakeSettings(method=method, solver=solver, bake_type=bake_type)
                assert (settings.method, settings.solver, settings.bake_type) == (method, solver, bake_type)


def test_settings_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        BakeSettings().seed = 3


def test_a_tighter_accuracy_never_means_less_work():
    accuracies = [0.5, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01, 0.005, 0.002]
    plans = [plan_for(accuracy) for accuracy in accuracies]
    for coarse, fine in pairwise(plans):
        assert fine.patches >= coarse.patches
        assert fine.patch_rays >= coarse.patch_rays
        assert fine.penumbra_rays >= coarse.penumbra_rays
        assert fine.indirect.rays >= coarse.indirect.rays
        assert fine.indirect.tolerance <= coarse.indirect.tolerance
        assert fine.tolerance < coarse.tolerance
    assert plans[-1].patches > 8 * plans[0].patches


def test_foreseen_memory_grows_with_all_that_takes_memory():
    plan, finer = plan_for(0.1), plan_for(0.01)
    least = foreseen_memory(0, 0, plan)
    assert least > 0
    assert foreseen_memory(1_000_000, 0, plan) - least >= 1_000_000 * 100
    assert foreseen_memory(0, 1_000_000, plan) - least >= 1_000_000 * 24  # direct and indirect light alone
    assert foreseen_memory(0, 0, finer) > least
