"""Direct light: closed forms in the open, dense sampling behind occluders, and many lamps at a bounded cost."""

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.keys import unique_pairs
from radiosity.core.lights import AreaLight, PointLight, SpotLight, SunLight
from radiosity.core.lights.direct_light import MAX_LIGHTS, choose_lights, direct_light
from radiosity.core.lights.table import LightTable
from radiosity.core.progress import finish
from radiosity.core.visibility.embree import RayPool, Tracer

from tests.scenes import grid

FLOOR = [(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)]
SQUARE = np.array([(-0.15, -0.15, 0.4), (-0.15, 0.15, 0.4), (0.15, 0.15, 0.4), (0.15, -0.15, 0.4)])
#: A plate between the floor and the lights, which all stand above it.
PLATE = np.array([(-0.1, -0.15, 0.2), (-0.1, 0.1, 0.2), (0.12, 0.1, 0.2), (0.12, -0.15, 0.2)])
LIGHTS = {
    "point": PointLight(np.array([0.05, 0.0, 0.4]), np.array([1.0, 2.0, 3.0])),
    "sphere": PointLight(np.array([0.05, 0.0, 0.4]), np.array([1.0, 2.0, 3.0]), 0.05),
    "soft": PointLight(np.array([0.05, 0.0, 0.4]), np.array([1.0, 2.0, 3.0]), 0.05, soft=True),
    "spot": SpotLight(np.array([0.05, 0.0, 0.4]), np.array([0.0, 0.0, -1.0]), np.ones(3), 1.4, 0.5, 0.03),
    "sun": SunLight(np.array([0.36, 0.48, 0.8]), np.array([1.0, 2.0, 3.0]), 0.2),
    "sharp-sun": SunLight(np.array([0.36, 0.48, 0.8]), np.array([1.0, 2.0, 3.0])),
    "area": AreaLight(SQUARE, np.array([1.0, 2.0, 3.0])),
}
every_light = pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())


def tracer_of(*quads):
    vertices = np.concatenate(quads).astype(np.float32) if quads else np.zeros((0, 3), np.float32)
    first = 4 * np.arange(len(quads))[:, None]
    triangles = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
    return Tracer.build(vertices, triangles)


def floor(divisions=30):
    """Points, normals and edges of a grid."""
    points, faces = grid(FLOOR, divisions, divisions)
    edges = unique_pairs(faces.ravel(), np.roll(faces, -1, axis=1).ravel(), len(points))
    return points.astype(np.float32), np.tile(np.float32([0, 0, 1]), (len(points), 1)), edges


def run(tracer, lights, points, normals, edges, rays=256, threads=1, seed=0, **more):
    with RayPool(threads) as pool:
        return finish(direct_light(tracer, lights, points, normals, edges, rays, pool, seed, **more))


@every_light
def test_open_floor_gets_the_closed_form(light):
    points, normals, edges = floor()
    value, rays = run(tracer_of(), [light], points, normals, edges)
    exact = light.geometry(points.astype(float), normals.astype(float))[:, None] * light.color
    # Points are lifted by 1e-5 of the scene towards the light: 5e-5 of 1 / r^2.
    np.testing.assert_allclose(value, exact, rtol=2e-4, atol=2e-4 * exact.max())
    assert 0 < rays <= light.scout(points[:1]).shape[1] * len(points)


@pytest.mark.parametrize("divisions", [12, 30])
@every_light
def test_shadows_agree_with_dense_sampling(light, divisions):
    points, normals, edges = floor(divisions)
    value, _ = run(tracer_of(PLATE), [light], points, normals, edges)
    exact = light.geometry(points.astype(float), normals.astype(float))
    # By hand: where 1,000 segments to the light cross the plate's height, and whether that is within the plate.
    segments, weights = light.aim(points.astype(float), normals.astype(float), 1000)
    crossing = points[:, None, :2] + segments[..., :2] * (0.2 / segments[..., 2:])
    hidden = ((crossing > PLATE.min(axis=0)[:2]) & (crossing < PLATE.max(axis=0)[:2])).all(axis=2)
    share = (weights * ~hidden).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-300)
    error = value[:, 0] - exact * share * light.color[0]
    scale = exact.mean() * light.color[0]
    assert 0.02 < (share < 0.5)[exact > 0].mean() < 0.6
    assert np.sqrt((error**2).mean()) < 0.02 * scale
    # A sharp light leaves no doubt but for points on the very edge of the shadow.
    if light.is_sharp:
        assert (np.abs(error) > 1e-3 * scale).mean() < 0.01


def test_penumbra_costs_rays_only_where_it_is():
    points, normals, edges = floor(60)
    light = LIGHTS["sphere"]
    _, everywhere = run(tracer_of(PLATE), [light], points, normals, edges, everywhere=True)
    value, found = run(tracer_of(PLATE), [light], points, normals, edges)
    assert everywhere == 256 * len(points)
    assert found < 0.6 * everywhere
    full, _ = run(tracer_of(PLATE), [light], points, normals, edges, everywhere=True)
    assert np.sqrt(((value - full) ** 2).mean()) < 0.003 * full.mean()


def test_a_wide_light_half_behind_a_fin_is_seen_in_half():
    # Every corner of the light and its middle are seen; what the fin hides lies between.
    light = AreaLight(np.array([(-0.5, -0.5, 0.5), (-0.5, 0.5, 0.5), (0.5, 0.5, 0.5), (0.5, -0.5, 0.5)]), np.ones(3))
    fin = np.array([(0.01, -0.5, 0.25), (0.01, 0.5, 0.25), (0.01, 0.5, 0.4999), (0.01, -0.5, 0.4999)])
    points, normals, edges = floor(20)
    value, _ = run(tracer_of(fin), [light], points, normals, edges)
    share, _ = run(tracer_of(fin), [light], points, normals, edges, 4096, everywhere=True)
    assert np.sqrt(((value - share) ** 2).mean()) < 0.02 * share.mean()
    open_light = point_to_polygon(points.astype(float), normals.astype(float), light.vertices)
    assert share[:, 0].mean() < 0.95 * open_light.mean()


def bar(center, axis, length, width):
    """A flat bar (4, 3) at `center`, along `axis` 0 or 1, level."""
    half = np.array([length, width] if axis == 0 else [width, length]) / 2
    return np.array([(x * half[0], y * half[1], 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) + center


def test_a_pane_behind_the_bars_of_its_window_is_seen():
    # The frame hides the rim, the cross hides the middle and both axes: what is seen lies between.
    frame = [bar((side * 0.08, 0, 0.395), 1, 0.2, 0.04) for side in (-1, 1)]
    frame += [bar((0, side * 0.08, 0.395), 0, 0.2, 0.04) for side in (-1, 1)]
    frame += [bar((0, 0, 0.395), axis, 0.2, 0.02) for axis in (0, 1)]
    points, normals, edges = floor(12)
    light = AreaLight(SQUARE * (0.5, 0.5, 1), np.ones(3))
    value, _ = run(tracer_of(*frame), [light], points, normals, edges)
    dense, _ = run(tracer_of(*frame), [light], points, normals, edges, 4096, everywhere=True)
    # Four panes of 0.05^2 in 0.15^2, seen from below, 0.395 of 0.4 of the way.
    below = np.abs(points[:, :2]).max(axis=1) < 0.1
    open_light = light.geometry(points.astype(float), normals.astype(float))
    assert (dense[below, 0] / open_light[below]).mean() == pytest.approx(4 * 0.05**2 / 0.15**2, rel=0.05)
    # A receiver's 256 rays meet eight edges of bars, and err by some of them.
    assert np.sqrt(((value - dense) ** 2).mean()) < 0.05 * dense.mean()


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, -0.8)])
@pytest.mark.parametrize("corners", [4, 3])
def test_close_to_a_wide_light_few_rays_do_not_carry_all_the_weight(normal, corners):
    # Nearly touching the light, a thousandth of its sides below it, before a wall that hides what lies beyond: 256 rays
    # must say the same as 65,536. One edge of visibility in 256 well-spread places errs by a few of them.
    light = AreaLight(np.array([(-0.5, -0.5, 0), (-0.5, 0.5, 0), (0.5, 0.5, 0), (0.5, -0.5, 0)])[:corners], np.ones(3))
    wall = np.array([(-0.1995, -0.5, -0.5), (-0.1995, 0.5, -0.5), (-0.1995, 0.5, -0.0005), (-0.1995, -0.5, -0.0005)])
    side = np.linspace(-0.45, -0.2, 23)
    points = np.stack([side, np.full(23, 0.123), np.full(23, -0.001)], axis=1).astype(np.float32)
    normals = np.tile(np.float32(normal), (23, 1))
    exact = light.geometry(points.astype(float), normals.astype(float))
    value, _ = run(tracer_of(wall), [light], points, normals, np.empty((0, 2), int), 256)
    dense, _ = run(tracer_of(wall), [light], points, normals, np.empty((0, 2), int), 65536, everywhere=True)
    assert (exact > 0).all()
    assert np.abs(value - dense).max() < 0.06 * exact.max()


def test_lights_add_up():
    points, normals, edges = floor(10)
    tracer = tracer_of(PLATE)
    together, _ = run(tracer, list(LIGHTS.values()), points, normals, edges)
    alone = sum(run(tracer, [light], points, normals, edges)[0].astype(float) for light in LIGHTS.values())
    np.testing.assert_allclose(together, alone, rtol=1e-5)


@pytest.mark.parametrize("threads", [2, 8])
def test_threads_do_not_change_a_bit(threads):
    points, normals, edges = floor(40)
    lights = [*LIGHTS.values(), *thousand()[:60]]
    one, rays = run(tracer_of(PLATE), lights, points, normals, edges)
    many, again = run(tracer_of(PLATE), lights, points, normals, edges, threads=threads)
    np.testing.assert_array_equal(one, many)
    assert rays == again


def test_no_points_and_no_lights():
    points, normals, edges = floor(3)
    value, rays = run(tracer_of(), [], points, normals, edges)
    assert not value.any() and rays == 0 and value.shape == (16, 3)
    value, rays = run(tracer_of(), [LIGHTS["point"]], points[:0], normals[:0], np.empty((0, 2), int))
    assert value.shape == (0, 3) and rays == 0


def test_a_receiver_on_the_light_itself_gets_nothing_from_it():
    vertices, faces = grid(SQUARE, 6, 6)
    edges = unique_pairs(faces.ravel(), np.roll(faces, -1, axis=1).ravel(), len(vertices))
    for two_sided in (False, True):
        light = AreaLight(SQUARE, np.ones(3), two_sided)
        down = np.tile(np.float32([0, 0, -1]), (len(vertices), 1))
        value, _ = run(tracer_of(SQUARE), [light], vertices.astype(np.float32), down, edges)
        np.testing.assert_array_equal(value, 0)


# --- many lights ------------------------------------------------------------------------------------------------------


def thousand(count=1000, seed=0):
    """Lamps of all kinds under a ceiling, of powers over two decades."""
    generator = np.random.default_rng(seed)
    lights = []
    for row in range(count):
        place = np.array([*generator.uniform(-0.5, 0.5, 2), generator.uniform(0.1, 0.5)])
        power = 10 ** generator.uniform(-2, 0) * np.ones(3)
        if row % 3 == 0:
            lights.append(PointLight(place, power))
        elif row % 3 == 1:
            lights.append(SpotLight(place, np.array([0.0, 0.0, -1.0]), power, 1.5, 0.2))
        else:
            lights.append(AreaLight(0.05 * SQUARE * (1, 1, 0) + place, 300 * power))
    return lights


def test_a_thousand_lamps_are_chosen_without_bias_at_a_bounded_cost():
    points, normals, edges = floor(40)
    lights = thousand()
    value, rays = run(tracer_of(), lights, points, normals, edges)
    exact = sum(light.geometry(points.astype(float), normals.astype(float)) * light.color[0] for light in lights)
    assert rays <= MAX_LIGHTS * 5 * len(points)
    # Each receiver's own error has a standard deviation; the mean over 1,681 receivers, whose draws are independent,
    # errs by that over 41. Allowed: four of those, and 1 % as the issue asks.
    relative = value[:, 0] / exact - 1
    assert relative.std() < 0.3
    assert abs(relative.mean()) < 4 * relative.std() / np.sqrt(len(points))
    assert value[:, 0].mean() == pytest.approx(exact.mean(), rel=0.01)


def test_mean_over_seeds_converges_to_the_sum_of_all_lamps_behind_an_occluder():
    points, normals, edges = floor(8)
    lights = thousand(200, 1)
    exact = sum(run(tracer_of(PLATE), [light], points, normals, edges)[0].astype(float) for light in lights)
    draws = np.array([run(tracer_of(PLATE), lights, points, normals, edges, seed=seed)[0] for seed in range(32)])
    deviation = draws.std(axis=0).mean() / np.sqrt(32)
    error = draws.mean(axis=0) - exact
    # 81 receivers: the largest of 81 standard scores is below 4.5 but once in a thousand runs.
    spread = np.maximum(draws.std(axis=0) / np.sqrt(32), 1e-3 * exact.mean())
    assert (np.abs(error) / spread).max() < 4.5
    assert deviation < 0.1 * exact.mean()


def test_factors_make_the_expected_sum_right_and_strong_lights_certain():
    points, normals, _ = floor(12)
    lights = thousand(100, 2)
    strong = PointLight(np.array([0.0, 0.0, 0.3]), np.full(3, 50.0))
    choices = choose_lights([strong, *lights], points, normals, 0)
    asked = np.zeros((len(points), 101))
    for column, choice in enumerate(choices):
        asked[choice.receivers, column] = choice.factors
    assert ((asked > 0).sum(axis=1) <= MAX_LIGHTS).all()
    np.testing.assert_array_equal(asked[:, 0], 1)
    # What is left to chance is drawn by its share: the sum of rates times factors is the sum of all rates.
    rates = LightTable([strong, *lights]).rates(points, normals).astype(float)
    np.testing.assert_allclose((rates * asked).sum(axis=1), rates.sum(axis=1), rtol=1e-3)


def test_few_lights_are_all_asked():
    points, normals, _ = floor(3)
    choices = choose_lights(thousand(MAX_LIGHTS), points, normals, 0)
    assert all(choice.receivers is None and choice.factors is None for choice in choices)
