"""The comparison of form factors: its scenes are what they claim to be, and the command writes its table."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from radiosity import core
from radiosity.core.form_factors.matrix import METHODS

from benchmarks.form_factor_scenes import SCENES, box, read_obj
from benchmarks.form_factor_slopes import measure

ROOT = Path(__file__).resolve().parents[1]
#: Inside Blender the tests put the package together by themselves, which a process of its own cannot see.
IS_INSIDE_BLENDER = "bpy" in sys.modules and bool(sys.modules["bpy"].app.binary_path)


def test_box_looks_outward_or_inward_on_all_sides():
    for inward in (False, True):
        environment = core.Environment.from_polygons(box((1, 2, 3), (2, 4, 6), inward, divisions=2))
        assert environment.areas.sum() == pytest.approx(22, rel=1e-12)
        outward = np.einsum("ij,ij->i", environment.centroids - (1.5, 3, 4.5), environment.normals)
        assert (outward < 0).all() if inward else (outward > 0).all()


@pytest.mark.parametrize("name", ["facing_plates", "touching_plates"])
def test_exact_method_reproduces_the_reference_of_a_scene(name):
    scene = SCENES[name]()
    found = scene.surface_factors(core.form_factors(scene.environment, "contour_integral", "none").matrix)
    known = ~np.isnan(scene.factors)
    assert known.any()
    # Relative, as both are computed in float64 and lose a few roundings for each edge.
    np.testing.assert_allclose(found[known], scene.factors[known], rtol=1e-12)


def test_obj_polygons_keep_their_corners_and_bent_ones_become_triangles(tmp_path):
    path = tmp_path / "scene.obj"
    flat = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2/2 3//3 4\n"
    bent = "v 0 0 1\nv 1 0 1\nv 1 1 1.5\nv 0 1 1\nf -4 -3 -2 -1\n"
    path.write_text(f"# a comment\n{flat}{bent}f 1 2 2\n", encoding="utf-8")
    polygons = read_obj(path)
    assert [len(polygon) for polygon in polygons] == [4, 3, 3]
    np.testing.assert_array_equal(polygons[0], [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    np.testing.assert_array_equal(polygons[2], [(0, 0, 1), (1, 1, 1.5), (0, 1, 1)])


@pytest.mark.skipif(IS_INSIDE_BLENDER, reason="another process cannot import the package")
def test_command_writes_every_run_and_every_refusal_with_its_reason(tmp_path):
    command = [sys.executable, "-m", "benchmarks.form_factors", str(tmp_path), "--quick", "--methods=hemisphere"]
    subprocess.run([*command, "--scenes=facing_plates"], cwd=ROOT, check=True, capture_output=True)
    with (tmp_path / "runs.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    refused = {line["visibility"]: line["status"] for line in lines if line["scene"] == "any"}
    assert set(refused) == {"zbuffer", "bsp", "silhouettes", "brute_force", "none"}
    assert all("which only embree tells" in status for status in refused.values())
    runs = [line for line in lines if line["scene"] == "facing_plates"]
    # Even and random rays, at two accuracies; what is asked for is a standard error.
    assert [line["status"] for line in runs] == ["done"] * 4
    assert all(float(line["max_error"]) < 3 * float(line["accuracy"]) for line in runs)
    assert all(float(line["seconds"]) > 0 and float(line["peak_MB"]) > 0 for line in runs)
    with (tmp_path / "slopes.csv").open(encoding="utf-8") as file:
        slopes = list(csv.DictReader(file))
    assert {line["technique"] for line in slopes} == {"hemisphere, low discrepancy", "hemisphere, random"}


def test_errors_of_techniques_fall_as_theory_says():
    lines = measure(list(METHODS))
    slopes = {line["technique"]: line["slope"] for line in lines}
    # 40 errors know their RMS to a tenth, so four of them over a factor of 8 a slope to 0.06, over 64 to 0.03; three
    # times that. Errors of smooth rules are no noise, and hold within a twentieth.
    assert slopes["hemicube, along edges"] == pytest.approx(-1, abs=0.2)
    assert slopes["hemisphere, random"] == pytest.approx(-0.5, abs=0.1)
    assert slopes["hemisphere, low discrepancy"] < -0.58
    # A line of pixels errs by the root of its length where a turn makes them independent: -3/2. It is no less steep.
    assert slopes["hemicube, turned"] < -1.3
    assert slopes["single_plane, turned"] < -1.3
    assert slopes["disk, uniform"] == pytest.approx(-1, abs=0.05)
    assert slopes["point_to_point, vertices"] == pytest.approx(-2, abs=0.05)
    assert all(line["rms_error"] > 0 for line in lines)
