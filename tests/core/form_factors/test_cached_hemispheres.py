"""Gathering over the hemisphere: directions, where rays lead, and irradiance against closed forms."""

import numpy as np
import pytest
from radiosity.core.discretization.patches import build_patches
from radiosity.core.form_factors.cached_hemispheres import Gathered, HitTable, gather, hemisphere_directions, turns_of
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.frames import tangents, turned_frames
from radiosity.core.progress import finish
from radiosity.core.scene import Sky
from radiosity.core.visibility.embree import RayPool, Tracer

from tests.scenes import box, grid

UP = np.array([0.0, 0.0, 1.0])


def triangles_of(faces):
    return np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


class Setting:
    """Triangles with one patch or more each, and a table of their radiosity."""

    def __init__(self, vertices, faces, target=12, two_sided=True, sky=None, transmittance=None):
        triangles = triangles_of(np.asarray(faces))
        self.vertices = np.asarray(vertices, dtype=float)
        self.patches = build_patches(self.vertices, triangles, np.zeros(len(triangles), int), target)
        self.tracer = Tracer.build(self.vertices.astype(np.float32), triangles, transmittance)
        self.hits = HitTable(self.patches, np.full(len(triangles), not two_sided), sky)

    def table(self, front=0.0, back=0.0):
        count = self.patches.count
        radiosity = np.zeros((2 * count, 3), np.float32)
        radiosity[:count], radiosity[count:] = front, back
        return self.hits.table(radiosity)

    def gather(self, points, normals, rays=256, threads=1, **more):
        with RayPool(threads) as pool:
            work = gather(
                self.tracer, self.hits, points.astype(np.float32), normals.astype(np.float32), rays, pool, **more
            )
            return finish(work)


CEILING = np.array([(-0.5, -0.5, 0.3), (-0.5, 0.5, 0.3), (0.5, 0.5, 0.3), (0.5, -0.5, 0.3)])


def panel(**look):
    vertices, faces = grid(CEILING, 1, 1)
    return Setting(vertices, faces, **look)


def below(count=200, seed=0):
    generator = np.random.default_rng(seed)
    points = generator.uniform(-0.4, 0.4, (count, 3)) * (1, 1, 0.3)
    normals = generator.normal(size=(count, 3)) + 2 * UP
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


# --- directions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [16, 64, 384, 1024])
def test_directions_are_unit_upward_and_cosine_distributed(count):
    directions = hemisphere_directions(count).astype(float)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1, atol=1e-6)
    assert directions.min(axis=(0, 1))[2] >= 0
    # Cosine-weighted means: z is 2/3, x and y 0, z^2 is 1/2, x^2 and y^2 1/4.
    np.testing.assert_allclose(directions.mean(axis=1), np.tile([0, 0, 2 / 3], (16, 1)), atol=2 / count)
    np.testing.assert_allclose((directions**2).mean(axis=1), np.tile([0.25, 0.25, 0.5], (16, 1)), atol=2 / count)
    # The variants differ.
    assert np.abs(np.diff(directions[:, 0, :2], axis=0)).max() > 0.01


def test_turns_are_uniform_and_depend_on_the_seed():
    turns = turns_of(100_000, 3)
    assert turns.min() >= 0 and turns.max() < 2 * np.pi + 1e-6
    # Uniform: a mean within five standard deviations, and all sixteenths filled alike.
    assert turns.mean() == pytest.approx(np.pi, abs=5 * 2 * np.pi / np.sqrt(12 * 100_000))
    counts = np.histogram(turns, 16, (0, 2 * np.pi))[0]
    assert np.abs(counts - 6250).max() < 5 * np.sqrt(6250)
    assert np.abs(np.corrcoef(turns[:-1], turns[1:])[0, 1]) < 0.02
    assert np.abs(np.corrcoef(turns, turns_of(100_000, 4))[0, 1]) < 0.02
    np.testing.assert_array_equal(turns[:100], turns_of(100, 3))


def test_frames_are_right_handed_and_turn_about_the_normal():
    normals = np.concatenate([np.eye(3), -np.eye(3), below(500)[1], [[0, 1e-9, -1]]])
    frames = turned_frames(normals, np.linspace(0, 6, len(normals)))
    np.testing.assert_allclose(
        np.einsum("nij,nkj->nik", frames, frames), np.tile(np.eye(3), (len(normals), 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-9)
    np.testing.assert_array_equal(frames[:, 2], normals)
    one, _ = tangents(normals)
    np.testing.assert_allclose(
        np.einsum("ni,ni->n", frames[:, 0], one), np.cos(np.linspace(0, 6, len(normals))), atol=1e-9
    )


# --- irradiance -------------------------------------------------------------------------------------------------------


def test_irradiance_of_a_panel_is_its_configuration_factor_and_the_error_falls_with_rays():
    setting = panel()
    points, normals = below()
    exact = point_to_polygon(points, normals, CEILING)
    errors = []
    for rays in (16, 64, 256, 1024):
        value = setting.gather(points, normals, rays).irradiance(setting.table(front=1.0))[:, 0]
        errors.append(np.sqrt(((value - exact) ** 2).mean()))
    # The study: about rays^-0.75 for a Fibonacci lattice against an edge; random directions would give 0.03 at 256.
    assert errors[0] > 1.8 * errors[1] > 1.8**2 * errors[2] > 1.8**3 * errors[3]
    assert errors[2] < 0.01


def test_backs_are_black_unless_two_sided():
    points, normals = below()
    points = points + 0.5 * UP  # above the panel
    for two_sided in (True, False):
        setting = panel(two_sided=two_sided)
        seen = setting.gather(points, -normals)
        value = seen.irradiance(setting.table(front=1.0, back=2.0))[:, 0]
        exact = point_to_polygon(points, -normals, CEILING[::-1])
        np.testing.assert_allclose(value, 2 * exact * two_sided, atol=0.05)
        black = (seen.rows == setting.hits.black_row).mean(axis=1)
        np.testing.assert_allclose(black, exact * (not two_sided), atol=0.03)


def test_every_ray_within_a_closed_box_meets_a_front():
    vertices, faces, _ = box(divisions=2)
    setting = Setting(vertices - 0.5, faces)
    points, normals = below(500)
    seen = setting.gather(points, normals, 128)
    assert (seen.rows < setting.patches.count).all()
    np.testing.assert_allclose(seen.irradiance(setting.table(front=1.0)), 1, rtol=1e-5)


def test_rays_into_the_open_are_outside_or_sky():
    points, normals = np.zeros((3, 3)), np.tile(-UP, (3, 1))
    setting = panel()
    assert (setting.gather(points, normals).rows == setting.hits.outside_row).all()
    under = panel(sky=Sky(np.full((1, 1, 3), 0.25)))
    seen = under.gather(points, normals)
    assert (seen.rows == under.hits.sky_start).all()
    np.testing.assert_allclose(seen.irradiance(under.table()), 0.25 * np.pi, rtol=1e-5)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_sky_irradiance_of_half_a_sky_along_each_axis(direction):
    # The half of the sky towards `direction` has radiance 1: what faces it gets pi, what faces across it pi / 2.
    bands, columns = 40, 80
    z = -1 + 2 * (np.arange(bands) + 0.5) / bands
    azimuth = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    rim = np.sqrt(1 - z**2)
    cells = np.stack(
        [np.outer(rim, np.cos(azimuth)), np.outer(rim, np.sin(azimuth)), np.outer(z, np.ones(columns))], -1
    )
    radiance = np.repeat((cells @ np.array(direction, float) > 0)[..., None], 3, axis=2).astype(float)
    setting = panel(sky=Sky(radiance))
    normals = np.array([direction, np.roll(direction, 1), np.negative(direction)], float)
    away = np.tile([30.0, 20.0, 10.0], (3, 1))
    value = setting.gather(away, normals, 1024).irradiance(setting.table())[:, 0]
    np.testing.assert_allclose(value, [np.pi, np.pi / 2, 0], atol=0.02 * np.pi)


def test_rays_along_a_wall_do_not_see_its_back():
    # A receiver in the corner of floor and wall: rays nearly parallel to the wall fall on either side by rounding.
    vertices, faces, _ = box(divisions=1)
    setting = Setting(vertices - 0.5, faces, two_sided=False)
    points = np.array([[0.0, -0.5 + 4e-5, -0.5], [-0.5 + 4e-5, -0.5 + 4e-5, -0.5]])
    seen = setting.gather(points, np.tile(UP, (2, 1)), 4096)
    assert (seen.rows < setting.patches.count).all()


@pytest.mark.parametrize(("slope", "back"), [(-1e-2, False), (5e-5, False), (2e-4, True), (0.5, True)])
def test_hits_at_grazing_angles_count_as_front(slope, back):
    setting = panel()
    hits = {
        "primID": np.zeros(1, np.int32),
        "u": np.full(1, 0.3, np.float32),
        "v": np.full(1, 0.3, np.float32),
        "Ng": np.array([[0, 0, -7.0]], np.float32),
    }
    row = setting.hits.look_up(hits, np.array([[1, 0, -slope]], np.float32))
    assert (row[0] >= setting.patches.count) == back


def test_harmonic_mean_distance_under_a_wide_ceiling():
    # Mean of 1 / d over cosine-weighted directions is (2 / 3) / h under an endless ceiling at height h.
    vertices, faces = grid(CEILING * (20, 20, 1), 1, 1)
    setting = Setting(vertices, faces)
    height = np.array([0.1, 0.2, 0.29])
    points = np.stack([0 * height, 0 * height, 0.3 - height], axis=1)
    seen = setting.gather(points, np.tile(UP, (3, 1)), 1024)
    np.testing.assert_allclose(seen.distances, 1.5 * height, rtol=0.02)
    nothing = setting.gather(points, np.tile(-UP, (3, 1)), 64)
    assert (nothing.distances > 1e3).all()


def test_names_make_a_receivers_rays_independent_of_its_place_in_the_call():
    setting = panel()
    points, normals = below(300)
    whole = setting.gather(points, normals, 32, seed=3)
    some = np.array([250, 3, 117])
    part = setting.gather(points[some], normals[some], 32, seed=3, names=some)
    np.testing.assert_array_equal(part.rows, whole.rows[some])
    np.testing.assert_array_equal(part.distances, whole.distances[some])


@pytest.mark.parametrize("threads", [2, 8])
def test_threads_do_not_change_a_row(threads):
    setting = panel(transmittance=np.array([0.5, 0.25]))
    points, normals = below(3000)
    one, many = setting.gather(points, normals, 64), setting.gather(points, normals, 64, threads)
    np.testing.assert_array_equal(one.rows, many.rows)
    np.testing.assert_array_equal(one.distances, many.distances)


def test_a_veil_lets_its_share_through_in_every_direction():
    setting = panel(transmittance=np.array([0.5, 0.5]))
    points, normals = below()
    seen = setting.gather(points, normals, 256)
    exact = point_to_polygon(points, normals, CEILING)
    value = seen.irradiance(setting.table(front=1.0))[:, 0]
    assert np.sqrt(((value - 0.5 * exact) ** 2).mean()) < 0.015
    # Half of a panel to one side: the chance must not follow the azimuth.
    triangles = setting.patches.point_triangles[:, 0]
    table = setting.table()
    table[np.nonzero(triangles == 0)[0], :3] = 1.0
    half = point_to_polygon(points, normals, CEILING[:3])
    value = seen.irradiance(table)[:, 0]
    assert np.sqrt(((value - 0.5 * half) ** 2).mean()) < 0.015


def test_irradiance_is_the_mean_of_the_table_in_float64():
    generator = np.random.default_rng(5)
    rows = generator.integers(0, 50, (1000, 37)).astype(np.int32)
    table = np.zeros((50, 4), np.float32)
    table[:, :3] = generator.random((50, 3))
    value = Gathered(rows, np.ones(1000, np.float32)).irradiance(table)
    np.testing.assert_allclose(value, table[rows, :3].astype(float).mean(axis=1), rtol=1e-5)
