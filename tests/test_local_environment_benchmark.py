"""The benchmark of local environments: its rooms are what they claim to be, and the command writes its table."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solver_scenes import LAMP, divided, row_of_rooms

ROOT = Path(__file__).resolve().parents[1]
#: Inside Blender the tests put the package together by themselves, which a process of its own cannot see.
IS_INSIDE_BLENDER = "bpy" in sys.modules and bool(sys.modules["bpy"].app.binary_path)


@pytest.mark.parametrize("doorway", [True, False])
def test_rooms_are_alike_and_lit_as_asked(doorway):
    one, row = row_of_rooms(1), row_of_rooms(3, lit=(0, 2), doorway=doorway)
    # Walls of 0.1 m and two faces, less the doorway, whose sides and top are walls, too.
    faces = 2 * (4 * 2.6 - (0.9 * 2.1 if doorway else 0)) + 0.1 * ((2 * 2.6 + 0.9) if doorway else 2 * 2.6)
    ends = 2 * 4 * 2.6
    room = one.areas.sum() - ends
    strips = 0.1 * 2 * (4 + 2.6)
    lamp = 2 * (0.8 * 0.6 + 0.03 * (0.8 + 0.6))
    assert row.areas.sum() == pytest.approx(3 * room + ends + 2 * (faces + strips) - lamp, rel=1e-12)
    lamps = np.flatnonzero(row.emission.any(axis=1))
    np.testing.assert_array_equal(row.emission[lamps], [LAMP, LAMP])
    np.testing.assert_allclose(row.normals[lamps], [(0, 0, -1)] * 2, atol=1e-15)
    np.testing.assert_allclose(row.centroids[lamps, 0], (2.3, 2.3 + 10.2))


def test_patches_are_no_larger_than_asked_whatever_the_length_of_the_row():
    for rooms in (1, 4):
        environment = row_of_rooms(rooms)
        patches = divided(environment, 0.8)
        assert patches.areas.max() <= 0.8**2 * (1 + 1e-9)
        assert patches.areas.sum() == pytest.approx(environment.areas.sum(), rel=1e-12)


@pytest.mark.skipif(IS_INSIDE_BLENDER, reason="another process cannot import the package")
def test_command_writes_every_run_with_its_growth_over_linear(tmp_path):
    path = tmp_path / "runs.csv"
    command = [sys.executable, "-m", "benchmarks.local_environments", str(path), "--rooms=4", "--undivided=2"]
    subprocess.run([*command, "--edge=4", "--accuracy=0.02"], cwd=ROOT, check=True, capture_output=True)
    with path.open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [(line["rooms"], line["strategy"]) for line in lines] == [
        ("2", "undivided"),
        ("2", "black_boundary"),
        ("2", "transparent_boundary"),
        ("4", "black_boundary"),
        ("4", "transparent_boundary"),
    ]
    assert all(line["converged"] == "True" and float(line["peak_MB"]) > 0 for line in lines)
    assert all(line["cells"] == line["rooms"] for line in lines[1:])
    assert all(float(line["time_growth"]) == 1 == float(line["memory_growth"]) for line in lines[:3])
    for line in lines[3:]:
        base = next(other for other in lines if other["strategy"] == line["strategy"])
        grown = float(line["peak_MB"]) / (2 * float(base["peak_MB"]))
        assert float(line["memory_growth"]) == pytest.approx(grown, rel=2e-3)  # four digits
    for line in lines[1:3]:
        assert 0 < float(line["error"]) < float(line["estimated_error"])
