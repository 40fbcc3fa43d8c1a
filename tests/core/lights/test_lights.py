"""Each kind of light against its closed form, a brute-force integral, and its own samples."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.lights import AreaLight, PointLight, SpotLight, SunLight, sampling
from radiosity.core.lights.emissive import FAINT_SHARE, WIDE_SHARE, area_lights
from radiosity.core.lights.point import sphere_irradiance
from radiosity.core.lights.table import LightTable

from tests.reference_cases import form_factor_cases
from tests.scenes import box, grid, inward_sphere

UP = np.array([0.0, 0.0, 1.0])
SQUARE = np.array([[-0.2, -0.1, 0.6], [-0.2, 0.3, 0.6], [0.3, 0.3, 0.6], [0.3, -0.1, 0.6]])
PENTAGON = np.array([[np.cos(a), -np.sin(a), 0.0] for a in 2 * np.pi * np.arange(5) / 5]) * 0.2 + [0.1, 0, 0.7]
LIGHTS = {
    "point": PointLight(np.array([0.1, -0.2, 0.6]), np.array([1.0, 2.0, 3.0])),
    "sphere": PointLight(np.array([0.1, -0.2, 0.6]), np.array([1.0, 2.0, 3.0]), 0.2),
    "soft": PointLight(np.array([0.1, -0.2, 0.6]), np.array([1.0, 2.0, 3.0]), 0.2, soft=True),
    "sharp-spot": SpotLight(np.array([0.1, -0.2, 0.6]), -UP, np.ones(3), 1.2, 0.4),
    "spot": SpotLight(np.array([0.1, -0.2, 0.6]), -UP, np.ones(3), 1.2, 0.4, 0.05),
    "sharp-sun": SunLight(np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0])),
    "sun": SunLight(np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0]), 0.3),
    "area": AreaLight(SQUARE, np.array([1.0, 2.0, 3.0])),
    "pentagon": AreaLight(PENTAGON, np.array([1.0, 2.0, 3.0])),
    "two-sided": AreaLight(SQUARE, np.ones(3), two_sided=True),
}
all_lights = pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())


def receivers(count=300, seed=0):
    """Points below and beside the lights, most of their normals upward."""
    generator = np.random.default_rng(seed)
    points = generator.uniform(-0.5, 0.5, (count, 3)) * (1, 1, 0.4)
    normals = generator.normal(size=(count, 3)) + 1.5 * UP
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


# --- closed forms -----------------------------------------------------------------------------------------------------


def test_point_light_falls_with_the_square_of_distance_and_the_cosine():
    light = LIGHTS["point"]
    points, normals = receivers()
    towards = light.position - points
    distance = np.linalg.norm(towards, axis=1)
    expected = np.maximum((towards * normals).sum(axis=1), 0) / distance**3
    np.testing.assert_allclose(light.geometry(points, normals), expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["el-sphere-1-3-30", "el-sphere-1-3-80"])
def test_sphere_meets_the_published_configuration_factor(name):
    case = form_factor_cases()[name]
    factor = next(entry["F"] for entry in case["expected"])
    angle = np.radians(float(name.rsplit("-", 1)[1]))
    # A sphere of intensity 1 has radiance 1 / (pi r^2), so its exitance times the factor is F / r^2.
    value = sphere_irradiance(np.array([np.cos(angle)]), np.array([3.0]), 1.0)
    np.testing.assert_allclose(value, factor, rtol=1e-9)


@pytest.mark.parametrize("angle", [0, 40, 75, 85, 89, 91, 95, 105, 125])
@pytest.mark.parametrize("distance", [1.05, 1.5, 4.0])
def test_sphere_agrees_with_the_integral_over_its_solid_angle(angle, distance):
    normal = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    cap = np.arcsin(1 / distance)
    heights = np.cos(cap) + (1 - np.cos(cap)) * (np.arange(1000) + 0.5) / 1000
    azimuths = 2 * np.pi * (np.arange(1000) + 0.5) / 1000
    rims = np.sqrt(1 - heights**2)
    cosines = np.maximum(heights[:, None] * normal[2] + rims[:, None] * np.cos(azimuths) * normal[0], 0)
    expected = cosines.mean() * 2 * np.pi * (1 - np.cos(cap)) / np.pi
    value = sphere_irradiance(np.array([normal[2]]), np.array([distance]), 1.0)
    np.testing.assert_allclose(value, expected, rtol=1e-3, atol=1e-6)  # midpoint rule over the horizon's kink


def test_small_sphere_is_a_point():
    points, normals = receivers()
    small = replace(LIGHTS["point"], radius=1e-5)
    np.testing.assert_allclose(
        small.geometry(points, normals), LIGHTS["point"].geometry(points, normals), rtol=1e-6, atol=1e-6
    )


def test_soft_lamp_stays_finite_within_itself():
    light = LIGHTS["soft"]
    near = light.position - np.array([[0.0, 0.0, 1e-6], [0.0, 0.0, 0.2]])
    np.testing.assert_allclose(light.geometry(near, np.tile(UP, (2, 1))), [1 / 0.04, 1 / 0.08], rtol=1e-6)


@pytest.mark.parametrize("radius", [0.0, 0.01])
def test_spot_is_a_point_lamp_within_its_cone_and_dark_outside(radius):
    spot = replace(LIGHTS["spot"], blend=0.0, radius=radius)
    points, normals = receivers()
    apart = points - spot.position
    angle = np.arccos(apart @ spot.direction / np.linalg.norm(apart, axis=1))
    margin = 2 * radius / np.linalg.norm(apart, axis=1)
    inside, outside = angle < spot.angle / 2 - margin, angle > spot.angle / 2 + margin
    assert inside.sum() > 20 and outside.sum() > 20
    whole = PointLight(spot.position, spot.intensity, radius).geometry(points, normals)
    np.testing.assert_allclose(spot.geometry(points, normals)[inside], whole[inside], rtol=1e-12)
    np.testing.assert_array_equal(spot.geometry(points, normals)[outside], 0)


def test_spots_blend_fades_by_a_smoothstep_of_the_cosine():
    spot = LIGHTS["sharp-spot"]
    rim = np.cos(spot.angle / 2)
    shares = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    cosines = rim + shares * (1 - rim) * spot.blend
    directions = np.stack([np.sqrt(1 - cosines**2), 0 * cosines, -cosines], axis=1)
    np.testing.assert_allclose(spot.falloff(directions), shares**2 * (3 - 2 * shares), atol=1e-9)


def test_sharp_sun_gives_the_cosine():
    points, normals = receivers()
    light = LIGHTS["sharp-sun"]
    np.testing.assert_allclose(light.geometry(points, normals), np.maximum(normals @ light.direction, 0), rtol=1e-12)


def test_wide_sun_gives_its_irradiance_on_what_faces_it_and_half_light_at_the_horizon():
    light = LIGHTS["sun"]
    facing = light.geometry(np.zeros((1, 3)), light.direction[None])
    np.testing.assert_allclose(facing, 1, rtol=1e-12)
    across = light.geometry(np.zeros((1, 3)), np.array([[0.8, 0.0, -0.6]]))
    # A small disk of half angle a cut in two at the horizon: 2 sin(a) / (3 pi) of its irradiance, to first order.
    np.testing.assert_allclose(across, 2 * np.sin(0.15) / (3 * np.pi), rtol=0.02)


@pytest.mark.parametrize("name", ["area", "pentagon", "two-sided"])
def test_area_light_is_the_configuration_factor(name):
    light = LIGHTS[name]
    points, normals = receivers()
    expected = point_to_polygon(points, normals, light.vertices, two_sided=light.two_sided)
    np.testing.assert_array_equal(light.geometry(points, normals), expected)
    assert expected.max() > 0.05


# --- what all lights promise ------------------------------------------------------------------------------------------


@all_lights
def test_samples_integrate_to_the_closed_form(light):
    """The weights of `aim`, times what the light's surface gives per place, are the irradiance."""
    points, normals = receivers(60)
    segments, weights = light.aim(points, normals, 4000)
    if isinstance(light, AreaLight):
        # Radiance 1/pi; the cosine at the light times distance is the height over its plane.
        height = np.abs(np.einsum("nci,i->nc", segments, light.normal))
        facing = np.einsum("nci,i->nc", segments, light.normal) < 0
        value = (weights * height * (facing | light.two_sided)).mean(axis=1) * light.area / np.pi
    elif isinstance(light, SunLight):
        value = weights.mean(axis=1)
    else:
        towards = light.position - points
        distance = np.linalg.norm(towards, axis=1)
        if light.is_sharp:
            cosine = np.maximum((towards * normals).sum(axis=1), 0) / distance
            value = weights[:, 0] * cosine / distance**2
        else:
            # The disk that faces the point: cos at the point, at the disk, area, radiance 1 / (pi r^2).
            square = (segments**2).sum(axis=2)
            lean = np.einsum("nci,ni->nc", segments, towards) / distance[:, None]
            value = (weights * lean / square**2).mean(axis=1)
    exact = light.geometry(points, normals)
    assert (exact > 0).sum() >= 15
    # Samples of a disk stand for a sphere of the same outline only from afar; a spot's cone is taken at 16 places.
    tolerance = {"sphere": 0.2, "spot": 0.15, "sun": 0.02, "soft": 0.15}
    (name,) = [key for key, value in LIGHTS.items() if value is light]
    np.testing.assert_allclose(value, exact, rtol=0.01, atol=tolerance.get(name, 0.003) * exact.max())


@all_lights
def test_irradiance_is_the_same_in_every_frame(light):
    center, size = np.array([3.0, -2.0, 1.0]), 250.0
    points, normals = receivers()
    framed = light.in_frame(center, size)
    expected = light.geometry(points, normals)[:, None] * light.color
    value = framed.geometry((points - center) / size, normals)[:, None] * framed.color
    np.testing.assert_allclose(value, expected, rtol=1e-8, atol=1e-12)


@all_lights
def test_nothing_arrives_from_below_the_horizon(light):
    points, _ = receivers(100)
    down = np.tile(-UP, (100, 1))
    np.testing.assert_array_equal(light.geometry(points, down), 0)


@all_lights
def test_scouts_and_samples_end_on_the_light(light):
    points, normals = receivers(40)
    for segments in (light.scout(points), light.aim(points, normals, 64)[0]):
        assert segments.shape[0] == 40 and segments.shape[2] == 3
        ends = points[:, None] + segments
        if isinstance(light, AreaLight):
            np.testing.assert_allclose((ends - light.vertices[0]) @ light.normal, 0, atol=1e-12)
            assert (ends.max(axis=(0, 1)) <= light.vertices.max(axis=0) + 1e-12).all()
            assert (ends.min(axis=(0, 1)) >= light.vertices.min(axis=0) - 1e-12).all()
        elif isinstance(light, SunLight):
            directions = segments / np.linalg.norm(segments, axis=2, keepdims=True)
            assert np.arccos(np.minimum(directions @ light.direction, 1)).max() <= light.angle / 2 + 1e-6
            assert np.linalg.norm(segments, axis=2).min() > np.sqrt(3), "beyond any scene of size 1"
        else:
            away = np.linalg.norm(ends - light.position, axis=2)
            assert away.max() <= light.radius + 1e-9
        assert segments.shape[1] == 1 or not light.is_sharp


@all_lights
def test_rough_rates_are_above_zero_wherever_light_arrives(light):
    points, normals = receivers(2000, seed=3)
    rates = LightTable([light]).rates(points, normals)[:, 0]
    exact = light.geometry(points, normals) * light.color.max()
    assert (rates[exact > 1e-9] > 0).all()
    # And they are right to a factor of a few where nothing is cut.
    clear = exact > 0.3 * exact.max()
    assert (rates[clear] / exact[clear]).max() < 8
    assert (rates[clear] / exact[clear]).min() > 0.2


@pytest.mark.parametrize(
    ("light", "power"),
    [
        (LIGHTS["point"], 4 * np.pi),
        (LIGHTS["sphere"], 4 * np.pi),
        (LIGHTS["spot"], 4 * np.pi * (1 - np.cos(0.6)) / 2),
        (LIGHTS["area"], 0.2),
        (LIGHTS["two-sided"], 0.4),
        (LIGHTS["sun"], 1.0),
    ],
)
def test_power_of_the_first_channel(light, power):
    assert light.power[0] == pytest.approx(power)


def test_point_light_sends_its_power_into_a_sphere_around_it():
    scene = inward_sphere(12, radius=2.0)
    corners = scene.surfaces.vertices[scene.surfaces.triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crosses, axis=1) / 2
    light = PointLight(np.array([0.3, -0.4, 0.5]), np.ones(3), 0.1)
    arriving = light.geometry(corners.mean(axis=1), crosses / (2 * areas[:, None]))
    assert (areas * arriving).sum() == pytest.approx(light.power[0], rel=0.01)  # midpoint rule on 1,728 triangles


# --- places -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 5, 64, 1000])
def test_samples_fill_their_shapes_evenly(count):
    square, disk = sampling.square(count), sampling.disk(count)
    assert ((square >= 0) & (square < 1)).all()
    assert (np.linalg.norm(disk, axis=1) <= 1).all()
    # Means err by about 1 / count for such sequences.
    np.testing.assert_allclose(square.mean(axis=0), 0.5, atol=2 / count)
    np.testing.assert_allclose(disk.mean(axis=0), 0, atol=2 / count)
    if count >= 64:
        np.testing.assert_allclose((disk**2).sum(axis=1).mean(), 0.5, atol=2 / count)


@pytest.mark.parametrize("polygon", [SQUARE, PENTAGON, SQUARE[:3]], ids=["square", "pentagon", "triangle"])
def test_polygon_samples_have_its_centroid(polygon):
    places = sampling.polygon(polygon, 4000)
    fan = np.stack([np.repeat(polygon[:1], len(polygon) - 2, axis=0), polygon[1:-1], polygon[2:]], axis=1)
    areas = np.linalg.norm(np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]), axis=1)
    centroid = areas @ fan.mean(axis=1) / areas.sum()
    np.testing.assert_allclose(places.mean(axis=0), centroid, atol=2e-3)


def test_disks_face_what_they_are_turned_to():
    directions = np.concatenate([np.eye(3), -np.eye(3), receivers(20)[1]])
    disks = sampling.facing_disks(directions, sampling.disk(50))
    np.testing.assert_allclose(np.einsum("nci,ni->nc", disks, directions), 0, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(disks, axis=2), np.linalg.norm(sampling.disk(50), axis=1)[None].repeat(26, 0)
    )


# --- emissive faces ---------------------------------------------------------------------------------------------------


def triangles_of(faces):
    return np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def room_with_panels(panel_emission, panels=4):
    """A box with small quads under its ceiling: vertices, triangles, emission (m, 3)."""
    vertices, faces, _ = box(divisions=2)
    parts = [vertices]
    triangles = [triangles_of(faces)]
    for row in range(panels):
        x = 0.1 + 0.2 * row
        quad = np.array([(x, 0.1, 0.9), (x, 0.2, 0.9), (x + 0.1, 0.2, 0.9), (x + 0.1, 0.1, 0.9)])
        triangles.append(triangles_of(np.array([[0, 1, 2, 3]])) + sum(map(len, parts)))
        parts.append(quad)
    emission = np.zeros((sum(map(len, triangles)), 3))
    emission[len(triangles[0]) :] = np.repeat(np.resize(panel_emission, panels), 2)[:, None]
    return np.concatenate(parts), np.concatenate(triangles), emission


def test_small_emissive_quads_become_lights_of_the_same_power():
    vertices, triangles, emission = room_with_panels(7.0)
    lights, sampled = area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 0.0)
    assert [len(light.vertices) for light in lights] == [4] * 4
    np.testing.assert_array_equal(sampled, emission.any(axis=1))
    assert sum(light.power[0] for light in lights) == pytest.approx(4 * 0.01 * 7)
    for light in lights:
        np.testing.assert_allclose(light.normal, -UP, atol=1e-12)


def test_two_sided_faces_shine_on_both_sides():
    vertices, triangles, emission = room_with_panels(1.0, 1)
    (light,), _ = area_lights(vertices, triangles, emission, np.ones(len(triangles), bool), 0.0)
    assert light.two_sided and light.power[0] == pytest.approx(0.02)


def test_faint_emitters_are_left_to_the_hemispheres():
    vertices, triangles, emission = room_with_panels([1.0, 1.0, 1.0, 0.5 * FAINT_SHARE])
    _, sampled = area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 0.0)
    assert sampled.sum() == 6
    # Beside a strong lamp all are faint.
    lights, sampled = area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 1e6)
    assert not lights and not sampled.any()


def test_emitters_that_fill_the_scene_are_left_to_the_hemispheres():
    vertices, faces, _ = box(divisions=2)
    triangles = triangles_of(faces)
    emission = np.zeros((len(triangles), 3))
    emission[: int(1.1 * WIDE_SHARE * len(triangles))] = 1
    assert not area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 0.0)[0]
    emission[int(0.9 * WIDE_SHARE * len(triangles)) :] = 0
    assert area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 0.0)[0]


def test_wide_emitters_far_apart_are_lights():
    vertices, faces = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 1, 1)
    triangles = np.concatenate([triangles_of(faces), triangles_of(faces) + 4])
    vertices = np.concatenate([vertices, vertices + np.array([0, 0, 50.0])]) / 50
    lights, _ = area_lights(vertices, triangles, np.ones((4, 3)), np.zeros(4, bool), 0.0)
    assert len(lights) == 2


@pytest.mark.parametrize(("bend", "count"), [(0.0, 1), (1e-4, 2), (-1e-4, 2)])
def test_bent_quads_stay_two_triangles(bend, count):
    vertices, triangles, emission = room_with_panels(1.0, 1)
    vertices[-1, 2] += bend
    lights, _ = area_lights(vertices, triangles, emission, np.zeros(len(triangles), bool), 0.0)
    assert len(lights) == count


def test_concave_pairs_stay_two_triangles():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0], [-5, -5, 5], [5, -5, 5], [0, 5, 5.0]]) / 10
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]])
    emission = np.repeat([[1.0], [1.0], [0.0]], 3, axis=1)
    lights, sampled = area_lights(vertices, triangles, emission, np.zeros(3, bool), 0.0)
    assert sampled.sum() == 2
    assert sum(light.power[0] for light in lights) == pytest.approx(0.002)
    assert all(len(light.vertices) == 3 for light in lights)


def test_a_glowing_dome_of_many_faces_is_left_to_the_hemispheres():
    scene = inward_sphere(12)
    corners = scene.surfaces.vertices[scene.surfaces.triangles]
    emission = np.repeat((corners.mean(axis=1)[:, 2:] > 0).astype(float), 3, axis=1)
    one_sided = np.zeros(len(emission), bool)
    lights, _ = area_lights(scene.surfaces.vertices / 2, scene.surfaces.triangles, emission, one_sided, 0.0)
    assert not lights
