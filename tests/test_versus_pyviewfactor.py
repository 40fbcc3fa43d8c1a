"""The comparison with pyviewfactor: its command asks another Python, and what stands in its table is true."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from radiosity import core

from benchmarks.form_factor_scenes import SCENES, divided
from benchmarks.versus_pyviewfactor import MESHES, Mesh, center_to_center, errors, meshes, touching_pairs

ROOT = Path(__file__).resolve().parents[1]
#: Inside Blender the tests put the package together by themselves, which a process of its own cannot see.
IS_INSIDE_BLENDER = "bpy" in sys.modules and bool(sys.modules["bpy"].app.binary_path)

#: Stands in for the two packages, which tests do not install: exact factors, in their convention and by their calls.
STAND_IN = """
import numpy as np
from radiosity import core

__version__ = "0.0"


def compute_viewfactor_matrix(mesh, obstacles, skip_obstruction):
    assert skip_obstruction == (obstacles is None)
    rest, polygons = list(mesh.faces), []
    while rest:
        polygons.append(mesh.points[rest[1 : 1 + rest[0]]])
        rest = rest[1 + rest[0] :]
    return core.form_factors(core.Environment.from_polygons(polygons), "contour_integral", "none").matrix.T
"""
MESH_STAND_IN = """
class PolyData:
    def __init__(self, points, faces):
        self.points, self.faces = points, faces
"""


@pytest.mark.parametrize("triangles", [False, True])
@pytest.mark.parametrize("divisions", [1, 3, 150.0])
def test_cells_cover_their_polygons_and_look_the_same_way(divisions, triangles):
    environment = SCENES["cornell_box"]().environment
    size = np.ptp(environment.vertices, axis=0).max()
    for row, polygon in enumerate(environment.polygons):
        normal, area = environment.normals[row], environment.areas[row]
        cells = core.Environment.from_polygons(divided([polygon], divisions, triangles))
        assert cells.areas.sum() == pytest.approx(area, rel=1e-12)
        np.testing.assert_allclose(cells.normals, np.tile(normal, (len(cells), 1)), atol=1e-9)
        center = cells.areas @ cells.centroids / area
        np.testing.assert_allclose(center, environment.centroids[row], atol=1e-12 * size)
        if divisions == 3:
            assert len(cells) == (9 if len(polygon) == 3 else 9 * (1 + triangles))


def test_meshes_have_about_the_patches_asked_for():
    for mesh in meshes(["touching_plates", "empty_room"], 200, 200):
        assert 200 <= len(mesh.polygons) <= 320
        corners = {len(polygon) for polygon in mesh.polygons}
        assert corners == ({3} if mesh.name.endswith("triangles") else {4})


def test_touching_patches_share_a_corner_and_plain_centers_err_there():
    make, _ = MESHES["touching_plates"]
    polygons = divided(make(), 2)
    touching = touching_pairs(polygons)
    centers = np.array([polygon.mean(axis=0) for polygon in polygons])
    # Cells of side 1/2: those with a corner in common are at most a diagonal apart, or around the edge.
    apart = np.linalg.norm(centers[:, None] - centers, axis=2)
    assert np.all(touching == ((apart > 0) & (apart < 0.71)))
    exact = core.form_factors(core.Environment.from_polygons(polygons), "contour_integral", "none").matrix
    plain, *_ = center_to_center(Mesh("plates", polygons, False))
    found = errors(plain, exact, touching)
    assert found["contact_error"] > 0.1
    assert found["max_error"] >= found["rms_error"] > 0
    far = plain[~touching & (exact > 0)] / exact[~touching & (exact > 0)]
    assert np.abs(far - 1).max() < found["contact_error"]


@pytest.mark.skipif(IS_INSIDE_BLENDER, reason="another process cannot import the package")
def test_command_compares_ours_with_what_the_other_python_says(tmp_path):
    for name, text in (("pyviewfactor", STAND_IN), ("pyvista", MESH_STAND_IN)):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "benchmarks.versus_pyviewfactor", str(tmp_path), "--python", sys.executable]
    command += ["--meshes=touching_plates,occluded_plates", "--patches=18", "--occluded-patches=12", "--repeat=1"]
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, env={**os.environ, "PYTHONPATH": paths})
    with (tmp_path / "versus_pyviewfactor.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert (tmp_path / "versus_pyviewfactor.md").read_text(encoding="utf-8").count("\n") == len(lines) + 2
    by_mesh = {name: [line for line in lines if line["mesh"] == name] for name in {line["mesh"] for line in lines}}
    assert len(by_mesh) == 4
    for name, some in by_mesh.items():
        error = {line["program"]: float(line["max_error"]) for line in some}
        if name.startswith("touching"):
            # The stand-in is exact, so its matrix must arrive as it is, each row the share of its own patch.
            assert error["pyviewfactor 0.0"] <= 1e-12
            assert error["contour_integral"] <= 1e-12 < error["contour_integral, fast"] <= 1e-3
            assert error["centers"] > 0.1
        else:
            # It knows no occlusion, which costs it the shadow.
            assert error["pyviewfactor 0.0"] > 0.02
            assert error["auto"] <= 1e-3 + 1e-4
            assert "centers" not in error
        assert all(float(line["pairs_per_cpu_second"]) > 0 for line in some)
