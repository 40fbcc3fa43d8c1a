"""Comparison of methods: what is tried, measured, left out and recommended."""

from types import SimpleNamespace

import numpy as np
import pytest
from radiosity.core.errors import NoEmittersError, SettingsError
from radiosity.core.lights import PointLight
from radiosity.core.progress import finish
from radiosity.core.settings import BakeSettings
from radiosity.core.verification import comparison
from radiosity.core.verification.comparison import Trial, compare_steps, default_accuracies, recommend
from radiosity.core.verification.measured_error import MeasuredError
from radiosity.core.verification.verification import StoredColors, verify_each_steps, verify_steps

from tests.bakes import Thing, bake, scene_of
from tests.scenes import box, cornell_box, furnace_box, grid


def compared(scene, accuracy=0.1, methods=("auto", "hemisphere"), **options):
    settings = BakeSettings(accuracy=accuracy, threads=1)
    return finish(compare_steps(scene, settings, methods, **{"places": 60, **options}))


def test_every_method_is_measured_as_a_bake_by_it_would_be():
    scene = cornell_box(6)
    found = compared(scene)
    assert [(trial.method, trial.accuracy) for trial in found.trials] == [("auto", 0.1), ("hemisphere", 0.1)]
    for trial in found.trials:
        assert trial.seconds > 0 and trial.rays > 0 and not trial.refusal
        alone = bake(scene, 0.1, method=trial.method)
        assert trial.estimated_error == alone.statistics["estimated_error"]
        colors = [StoredColors(mesh.corner_colors("lighting"), False) for mesh in alone.meshes]
        measured = finish(verify_steps(scene, colors, "lighting", 60, threads=1)).measured
        # The reference may have been followed longer for the sake of the other bake: its noise is part of both.
        assert abs(trial.measured.error - measured.error) <= 2 * max(measured.noise, trial.measured.noise)
        assert trial.measured.places == measured.places


def test_bakes_measured_together_are_measured_as_each_alone():
    scene = furnace_box(6)
    right = [StoredColors(mesh.corner_colors("lighting"), False) for mesh in bake(scene).meshes]
    wrong = [StoredColors(1.2 * colors.values, False) for colors in right]
    both = finish(verify_each_steps(scene, [right, wrong], "lighting", 60, 256, threads=1))
    alone = [finish(verify_steps(scene, stored, "lighting", 60, 256, threads=1)) for stored in (right, wrong)]
    assert both == alone


def test_what_is_no_finer_than_asked_for_is_tried_coarse_first():
    assert default_accuracies(0.03) == (0.1, 0.03)
    assert default_accuracies(0.02) == (0.1, 0.03, 0.02)
    assert default_accuracies(0.2) == (0.2,)


def trial(seconds, error, refusal=""):
    measured = None if refusal else MeasuredError(error, error, error, 0.0, 100)
    return Trial("auto", 0.1, seconds, measured=measured, refusal=refusal)


def test_the_fastest_that_keeps_the_accuracy_is_recommended():
    trials = [trial(0.1, 0.0, "refused"), trial(3, 0.01), trial(1, 0.04), trial(2, 0.03), trial(0.5, 0.2)]
    assert recommend(trials, 0.05) == 2
    assert recommend(trials, 0.03) == 3
    assert recommend(trials, 0.001) == 1  # none keeps it: the one that errs least
    assert recommend(trials[:1], 0.1) is None


def test_a_method_that_cannot_serve_the_scene_says_why_and_the_others_go_on():
    vertices, faces, _ = box((1.0, 1.0, 1.0), 4)
    veil = grid([(0.2, 0.2, 0.5), (0.8, 0.2, 0.5), (0.8, 0.8, 0.5), (0.2, 0.8, 0.5)], 2, 2)
    lamp = PointLight(np.array([0.5, 0.5, 0.8]), np.full(3, 0.05), 0.02)
    scene = scene_of(Thing(vertices, faces), Thing(*veil, transmittance=0.5, name="Veil"), lights=(lamp,))
    found = compared(scene, methods=("hemicube", "auto"), accuracies=(0.3, 0.2))
    refused, kept = found.trials[:2], found.trials[2:]
    assert all("'Veil'" in trial.refusal and trial.measured is None for trial in refused)
    assert all(trial.measured is not None for trial in kept)
    assert found.recommended in (2, 3) and found.keeps


def test_a_slow_method_is_not_asked_for_more(monkeypatch):
    monkeypatch.setattr(comparison, "LONG", 0.0)
    first, second = compared(furnace_box(4), methods=("auto",), accuracies=(0.1, 0.3)).trials
    assert (first.accuracy, second.accuracy) == (0.3, 0.1)
    assert first.measured is not None and second.measured is None
    assert second.refusal.startswith("not tried: took")


def test_what_concerns_every_method_is_raised():
    floor = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 2, 2)
    with pytest.raises(NoEmittersError):
        compared(scene_of(Thing(*floor)))
    with pytest.raises(SettingsError, match="at least one"):
        compared(furnace_box(4), methods=())
    with pytest.raises(SettingsError, match="Unknown method"):
        compared(furnace_box(4), methods=("auto", "magic"))
    with pytest.raises(SettingsError, match="Accuracy must lie"):
        compared(furnace_box(4), accuracies=(0.1, 0.0))


def test_time_between_steps_does_not_count(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(comparison, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    work = compare_steps(furnace_box(4), BakeSettings(accuracy=0.3, threads=1), ("auto",), places=60)
    while True:
        try:
            next(work)
        except StopIteration as end:
            found = end.value
            break
        clock[0] += 100.0  # a window that takes its time
    assert found.trials[0].seconds == 0.0
