"""The comparison of the levels of discretization: its scenes are the published ones, its errors what they say."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from radiosity import core

from benchmarks.discretization import SCENES, LitScene, descends, exact_factors, run_scene
from tests.reference_cases import solution_cases

ROOT = Path(__file__).resolve().parents[1]
#: Inside Blender the tests put the package together by themselves, which a process of its own cannot see.
IS_INSIDE_BLENDER = "bpy" in sys.modules and bool(sys.modules["bpy"].app.binary_path)


@pytest.mark.parametrize("name", ["facing_plates", "box_room"])
def test_undivided_scenes_have_the_published_radiosity(name):
    case = solution_cases()[SCENES[name]]
    environment, owners = LitScene.published(name, SCENES[name]).divided(1)
    found = core.solve(environment, exact_factors(environment, 0, 1), tolerance=1e-10).radiosity
    published = np.array([np.atleast_1d(value) for value in case["expected"]["B"].values()], dtype=float)[owners]
    # Factors are asked for at 1e-3, and nearest ones are exact.
    np.testing.assert_allclose(found, np.broadcast_to(published, found.shape), rtol=1e-4)


@pytest.mark.parametrize("name", list(SCENES))
def test_finest_patches_lie_within_those_of_their_level(name):
    scene = LitScene.published(name, SCENES[name])
    fine, _ = scene.divided(4)
    coarse, _ = scene.divided(2)
    parents = descends(scene, 2, 4)
    sums = np.bincount(parents, fine.areas, len(coarse))
    np.testing.assert_allclose(sums, coarse.areas, rtol=1e-12)
    centers = np.stack([np.bincount(parents, fine.areas * fine.centroids[:, axis]) for axis in range(3)], axis=1)
    size = np.ptp(coarse.vertices, axis=0).max()
    np.testing.assert_allclose(centers / sums[:, None], coarse.centroids, atol=1e-12 * size)


def test_errors_fall_with_patches_and_with_samples():
    lines = run_scene(LitScene.published("box_room", SCENES["box_room"]), (1, 2, 4), 8, 0, 1)
    floor = [line["discretization_error"] for line in lines if line["method"] == "auto"]
    # Light is even over a patch to first order in its size: halves, less what the reference shares with the finest.
    assert floor[0] > 1.4 * floor[1] > 1.4**2 * floor[2] > 0
    assert all(line["error"] == line["discretization_error"] for line in lines if line["method"] == "auto")
    for divisions in (1, 2, 4):
        rays = [x["sampling_error"] for x in lines if (x["method"], x["divisions"]) == ("hemisphere", divisions)]
        # From 64 to 16,384 rays: random ones alone would fall by 16.
        assert rays[0] > 10 * rays[-1] > 0
    for line in lines:
        # Both parts of an error, whatever their signs.
        low, high = (abs(line["discretization_error"] + sign * line["sampling_error"]) for sign in (-1, 1))
        assert low - 1e-9 <= line["error"] <= high + 1e-9


@pytest.mark.skipif(IS_INSIDE_BLENDER, reason="another process cannot import the package")
def test_command_writes_a_line_for_every_level_and_sampling(tmp_path):
    command = [sys.executable, "-m", "benchmarks.discretization", str(tmp_path), "--scenes=facing_plates"]
    subprocess.run([*command, "--levels=1,2", "--finest=4"], cwd=ROOT, check=True, capture_output=True)
    with (tmp_path / "discretization.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["patches"] for line in lines] == ["2"] * 11 + ["8"] * 11
    assert {line["method"] for line in lines} == {"auto", "hemicube", "hemisphere"}
    wrong = subprocess.run([*command, "--levels=3", "--finest=4"], cwd=ROOT, capture_output=True, text=True)
    assert wrong.returncode == 2
    assert "--finest 4 must be a multiple of every level of 3" in wrong.stderr
