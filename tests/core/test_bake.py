"""The whole bake against closed forms and published solutions.

Bakes that ask for 10 % take a tenth of a second and must still meet what does not depend on sampling: furnaces, powers,
darkness. Where sampling shows, the allowed error is the accuracy asked for, which is what the bake promises.
"""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.form_factors.point_to_polygon import point_to_polygon
from radiosity.core.lights import PointLight
from radiosity.core.scene import Sky

from tests.bakes import Thing, all_light, bake, corner_light, corner_places, relative_rms, scene_of
from tests.reference_cases import form_factor_cases, ids, polygons_of, solution_cases
from tests.scenes import box, cornell_box, furnace_box, grid, inward_sphere, joined, scene_from_quads

FACTORS = form_factor_cases()
SOLUTIONS = solution_cases()

#: What the issue asks of a furnace at every corner: float32 tables and the bounces left out when the solver stops.
FURNACE = 1e-3


def quads(polygons, divisions: int):
    """Vertices and faces of planar quads, each divided; a triangle is divided as a quad with a doubled corner."""
    parts = [grid(polygon, divisions, divisions) for polygon in polygons]
    vertices, faces, owners = joined(*parts)
    return vertices, faces, owners


def vertex_areas(vertices, faces):
    """(c,) area that each corner of quads stands for: a quarter of its face."""
    corners = vertices[faces]
    crosses = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return np.repeat(np.linalg.norm(crosses, axis=1) / 8, 4)


def _triangles(faces):
    return np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def area_mean(scene, values, mesh=0):
    """(3,) mean over the area of one mesh of quads, by the trapezoid rule."""
    receiver = scene.receivers[mesh]
    weights = vertex_areas(receiver.positions, receiver.corner_vertices.reshape(-1, 4))
    return weights @ values / weights.sum()


# --- furnaces: a closed scene that glows evenly has B = E / (1 - rho) everywhere ---------------------------------


@pytest.mark.parametrize("two_sided", [True, False], ids=["two-sided", "one-sided"])
@pytest.mark.parametrize("reflectance", [0.5, 0.9])
@pytest.mark.parametrize(
    "make",
    [furnace_box, inward_sphere, lambda **look: inward_sphere(smooth=False, **look)],
    ids=["box", "smooth-sphere", "flat-sphere"],
)
def test_furnace_is_even_everywhere(make, reflectance, two_sided):
    scene = make(reflectance=reflectance)
    scene = replace(
        scene, surfaces=replace(scene.surfaces, two_sided=np.full_like(scene.surfaces.two_sided, two_sided))
    )
    result = bake(scene)
    assert result.statistics["buried_receivers"] == 0
    # The bake stops at a change of 0.002 times the accuracy, which at rho = 0.9 leaves at most 9 times that undone.
    np.testing.assert_allclose(corner_light(result, "combined"), 1 / (1 - reflectance), rtol=2 * FURNACE)
    if reflectance == 0.5:
        np.testing.assert_allclose(corner_light(result, "combined"), 2, rtol=FURNACE)


FURNACES = [name for name in ids(SOLUTIONS, "furnace") if "form_factor_case" in SOLUTIONS[name]["geometry"]]


@pytest.mark.parametrize("name", FURNACES)
def test_published_furnaces(name):
    case = SOLUTIONS[name]
    polygons, _ = polygons_of(FACTORS[case["geometry"]["form_factor_case"]])
    vertices, faces, _ = quads([p if len(p) == 4 else p[[0, 1, 2, 2]] for p in polygons], 4)
    # Grids of a triangle end in one corner; what has no area there is left out.
    solid = vertex_areas(vertices, faces)[::4] > 1e-12
    channels = [np.resize(case[key]["uniform"], 3) for key in ("reflectance", "emission")]
    scene = scene_from_quads(vertices, faces[solid], np.zeros(int(solid.sum())), *channels)
    result = bake(scene)
    expected = np.resize(case["expected"]["uniform_B"], 3)
    level = case["tolerance"]["fine"]["rel"]
    np.testing.assert_allclose(corner_light(result, "combined"), np.broadcast_to(expected, (4 * solid.sum(), 3)), level)
    assert result.statistics["converged"]


def test_furnace_of_many_colors_and_extreme_powers_at_once():
    vertices, faces, _ = box(divisions=6)
    emission, reflectance = np.array([1e-8, 1.0, 1e8]), np.array([0.25, 0.5, 0.75])
    scene = scene_from_quads(vertices, faces, np.zeros(len(faces)), reflectance, emission)
    light = corner_light(bake(scene), "combined")
    np.testing.assert_allclose(light / (emission / (1 - reflectance)), 1, rtol=FURNACE)


def test_furnace_with_a_block_inside_stays_even_in_its_corners():
    scene = cornell_box(divisions=8)
    surfaces = scene.surfaces
    glow = replace(
        surfaces, reflectance=np.full_like(surfaces.reflectance, 0.5), emission=np.ones_like(surfaces.emission)
    )
    mesh = replace(scene.receivers[0], palette_reflectance=np.full((4, 3), 0.5), palette_emission=np.ones((4, 3)))
    result = bake(replace(scene, surfaces=glow, receivers=(mesh,)))
    light = corner_light(result, "combined")
    # The blocks' insides are a closed space of backs, which glow as well; vertices on the floor under them lie in it.
    np.testing.assert_allclose(light, 2, rtol=FURNACE)


# --- the sphere: every place sees every other alike, so irradiance is (mean E) / (1 - mean rho) whatever the colors


def sphere_of_two_halves(divisions):
    scene = inward_sphere(divisions)
    mesh = scene.receivers[0]
    faces = mesh.corner_vertices.reshape(-1, 4)
    upper = (mesh.positions[faces].mean(axis=1)[:, 2] > 0).astype(np.int32)
    return scene_from_quads(
        mesh.positions,
        faces,
        upper,
        [[0.8, 0.2, 0.5], [0.1, 0.6, 0.5]],
        [[0, 0, 0], [1.0, 2.0, 0.5]],
        normals=-mesh.positions,
    )


def test_integrating_sphere_of_two_halves():
    scene = sphere_of_two_halves(16)
    light = corner_light(bake(scene, 0.03))
    expected = np.array([0.5, 1.0, 0.25]) / (1 - np.array([0.45, 0.4, 0.5]))
    # A polyhedron of 16 quads per quarter turn is no sphere: its faces see less of each other, by about
    # (pi / 64)^2 = 0.24 %; the rest is the accuracy asked for.
    assert relative_rms(light, np.broadcast_to(expected, light.shape)) < 0.03
    np.testing.assert_allclose(light.mean(axis=0), expected, rtol=0.005)


def test_integrating_sphere_with_an_emitting_cap():
    divisions = 16
    scene = inward_sphere(divisions)
    mesh = scene.receivers[0]
    faces = mesh.corner_vertices.reshape(-1, 4)
    cap = (mesh.positions[faces].mean(axis=1)[:, 2] > 0.9).astype(np.int32)
    areas = vertex_areas(mesh.positions, faces)[::4]
    share = areas[cap == 1].sum() / areas.sum()
    scene = scene_from_quads(
        mesh.positions, faces, cap, [[0.8] * 3, [0.0] * 3], [[0.0] * 3, [10.0] * 3], normals=-mesh.positions
    )
    result = bake(scene, 0.03)
    light = corner_light(result)
    expected = 10.0 * share / (1 - 0.8 * (1 - share))
    # Flat faces of the cap do not see themselves, which takes at most a face's own share.
    assert relative_rms(light, np.full_like(light, expected)) < 0.03
    np.testing.assert_allclose(light.mean(), expected, rtol=0.01)
    assert result.statistics["lights"] > 0, "the cap is small enough to be aimed at"


# --- power in equals power absorbed --------------------------------------------------------------------------------


@pytest.mark.parametrize("case", SOLUTIONS["cie171-5.8-public"]["expected"]["cases"], ids=lambda case: str(case["rho"]))
def test_mean_indirect_light_of_a_closed_cube_with_a_lamp(case):
    vertices, faces, _ = box((4.0, 4.0, 4.0), 12)
    lamp = PointLight(np.full(3, 2.0), np.full(3, 10000 / (4 * np.pi)))
    scene = scene_of(Thing(vertices, faces, reflectance=case["rho"]), lights=[lamp])
    result = bake(scene, 0.03)
    direct = area_mean(scene, corner_light(result, "direct"))
    # The trapezoid rule on cells of 1/12 errs by h^2 / 12 times the curvature of 1 / r^2 light: about 0.3 %.
    np.testing.assert_allclose(direct, case["E_direct"], rtol=0.005)
    indirect = area_mean(scene, corner_light(result, "indirect"))
    # Power balance, with the trapezoid rule in the corners: between the fine level (0.5 %) and the coarse one.
    np.testing.assert_allclose(indirect, case["E_indirect"], rtol=0.01)


@pytest.mark.parametrize("seed", [0, 1])
def test_closed_room_absorbs_all_that_is_sent(seed):
    statistics = bake(cornell_box(), 0.03, seed=seed).statistics
    assert statistics["converged"]
    # Reciprocity of sampled factors is what is measured here: within the accuracy.
    assert statistics["light_absorbed"] == pytest.approx(1, abs=0.01)
    assert statistics["energy_balance_error"] < 0.01
    assert statistics["light_escaped"] == 0
    # Factors are kept in float32.
    assert statistics["closure_error_max"] < 2**-24


def test_open_scene_lets_power_escape():
    vertices, faces = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 8, 8)
    lamp = PointLight(np.array([0.5, 0.5, 0.2]), np.ones(3))
    result = bake(scene_of(Thing(vertices, faces, reflectance=0.25), lights=[lamp]))
    statistics = result.statistics
    # A plane alone reflects a quarter away and keeps three.
    assert statistics["light_absorbed"] == pytest.approx(0.75, abs=1e-5)
    assert statistics["light_escaped"] == pytest.approx(0.25, abs=1e-5)
    assert not corner_light(result, "indirect").any(), "a plane does not see itself"


@pytest.mark.parametrize("name", ["cie171-5.3-diffuse", "cie171-5.6-s2"])
def test_points_lit_by_an_area_as_in_cie_171(name):
    case = FACTORS[name]
    (source,), _ = polygons_of(case)
    # Points lie at odd multiples of 0.25 m: vertices of cells of that size.
    wall = grid([(0, 0, 0), (0, 0, 3), (4, 0, 3), (4, 0, 0)], 12, 16)
    level = case["elements"][-1]["point"][2]
    along = [(0, 0, level), (4, 0, level), (4, 4, level), (0, 4, level)]
    across = grid(along if level == 0 else along[::-1], 16, 16)
    lit = Thing(source, np.arange(4)[None], 0.3, 0.3, two_sided=False, receives=False)
    scene = scene_of(lit, *(Thing(*part, 0.0, two_sided=False) for part in (wall, across)))
    places = np.concatenate([corner_places(scene, mesh) for mesh in range(2)])
    light = all_light(bake(scene, 0.03)) / 0.3
    for element, entry in zip(case["elements"], case["expected"], strict=True):
        here = np.linalg.norm(places - element["point"], axis=1) < 1e-9
        np.testing.assert_allclose(light[here], entry["F"], rtol=1e-3)


# --- published pairs and rooms -------------------------------------------------------------------------------------

OBSTRUCTED = [
    name
    for name in ids(FACTORS, "obstructed")
    if {entry["to"] if isinstance(entry["to"], str) else "" for entry in FACTORS[name]["expected"]} & {"B"}
    and name not in ("obs-perp-plate", "obs-near-emitter", "obs-full")
]


@pytest.mark.parametrize(("accuracy", "allowed"), [(0.03, 0.02), pytest.param(0.005, 0.005, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", OBSTRUCTED)
def test_area_mean_behind_obstacles_is_the_published_form_factor(name, accuracy, allowed):
    case = FACTORS[name]
    things = []
    for surface in case["surfaces"]:
        emits, receives = surface["name"] == "A", surface["name"] == "B"
        for polygon in surface["polygons"]:
            corners = np.asarray(polygon, dtype=float)
            if receives and len(corners) == 4:
                vertices, faces = grid(corners, 31, 31)  # odd, so that no vertex lies on the edge of a fin's shadow
            else:
                vertices, faces = corners, np.arange(len(corners))[None]
            things.append(
                Thing(vertices, faces, 0.0, float(emits), two_sided=False, receives=receives, name=surface["name"])
            )
    entry = next(e for e in case["expected"] if e["to"] == "B")
    scene = scene_of(*things)
    mean = area_mean(scene, corner_light(bake(scene, accuracy)))
    # Areas of A and B are equal, so the mean on B is F(A -> B). All receivers look at the same places on A, so their
    # errors do not average out, but they are within the accuracy.
    np.testing.assert_allclose(mean, entry["F"], rtol=allowed)


def ward_room(cell: float):
    polygons, owners = polygons_of(FACTORS["enc-ward-room"])
    names = [surface["name"] for surface in FACTORS["enc-ward-room"]["surfaces"]]
    reflectance = {"source": 0.0, "ceiling": 0.7, "floor": 0.3}
    things = []
    for polygon, owner in zip(polygons, owners, strict=True):
        sides = np.linalg.norm(polygon[1] - polygon[0]), np.linalg.norm(polygon[3] - polygon[0])
        vertices, faces = grid(polygon, *(max(round(side / cell), 1) for side in sides))
        name = names[owner]
        things.append(
            Thing(vertices, faces, reflectance.get(name, 0.5), 31.416 * (name == "source"), name=name, two_sided=False)
        )
    return scene_of(*things)


@pytest.mark.parametrize(("accuracy", "level"), [(0.03, "coarse"), pytest.param(0.005, "fine", marks=pytest.mark.slow)])
def test_published_points_of_wards_room(accuracy, level):
    case = SOLUTIONS["ward-points-public"]
    scene = ward_room(0.25)
    result = bake(scene, accuracy)
    places = np.concatenate([corner_places(scene, mesh) for mesh in range(len(scene.receivers))])
    surfaces = np.repeat(
        [mesh.name for mesh in scene.receivers], [len(mesh.corner_vertices) for mesh in scene.receivers]
    )
    light = all_light(result, "combined")[:, 0]
    points = case["expected"]["points"]
    values = []
    for point in points:
        near = np.linalg.norm(places - point["point"], axis=1) + 10.0 * (surfaces != point["face"])
        values.append(light[near < near.min() + 1e-9].mean())
    np.testing.assert_allclose(values, [point["B"] for point in points], rtol=case["tolerance"][level]["rel"])


def test_sealed_cubes_share_no_light():
    polygons, owners = polygons_of(FACTORS["enc-two-sealed-cubes"])
    names = [surface["name"] for surface in FACTORS["enc-two-sealed-cubes"]["surfaces"]]
    things = [
        Thing(*grid(polygon, 8, 8), 0.8, float(names[owner] == "L_ceiling"), name=names[owner])
        for polygon, owner in zip(polygons, owners, strict=True)
    ]
    scene = scene_of(*things)
    result = bake(scene)
    for row, mesh in enumerate(scene.receivers):
        light = corner_light(result, "lighting", row)
        if mesh.name.startswith("R"):
            assert not light.any(), mesh.name
        else:
            assert light.min() > 0.1


def test_far_patch_receives_the_published_share():
    case = SOLUTIONS["openpair-100"]
    polygons = [surface["polygons"][0] for surface in case["geometry"]["surfaces"]]
    things = [
        Thing(*grid(polygon, 4, 4), case["reflectance"][name], case["emission"][name], name=name, two_sided=False)
        for polygon, name in zip(polygons, "AB", strict=True)
    ]
    scene = scene_of(*things)
    light = corner_light(bake(scene, 0.03), "combined", 1)
    # A hundredth of a degree across: the direct light is in closed form, so the exact kernel's level holds.
    np.testing.assert_allclose(area_mean(scene, light, 1), case["expected"]["B"]["B"], rtol=1e-4)


def test_two_bounces_between_parallel_plates_agree_with_a_two_point_quadrature():
    # Plates of reflectance 0 and 0.5: what A receives is one bounce off B, an integral of two configuration factors.
    low, high = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1)]
    scene = scene_of(
        Thing(*grid(low, 6, 6), 0.0, 1.0, two_sided=False), Thing(*grid(high, 6, 6), 0.5, 0.0, two_sided=False)
    )
    light = corner_light(bake(scene, 0.03))[:, 0]
    places = corner_places(scene)
    side = (np.arange(48) + 0.5) / 48
    on_top = np.stack([*(axis.ravel() for axis in np.meshgrid(side, side)), np.ones(48 * 48)], axis=1)
    down = np.broadcast_to([0.0, 0.0, -1.0], on_top.shape)
    bounced = 0.5 * point_to_polygon(on_top, down, np.array(low, dtype=float))
    apart = on_top[None] - places[:, None]
    kernel = 1 / (np.pi * (apart**2).sum(axis=2) ** 2)
    expected = (kernel * bounced).mean(axis=1)
    assert relative_rms(light, expected) < 0.03


# --- walls and solids -----------------------------------------------------------------------------------------------


def divided_room(thickness: float, divisions: int = 16):
    """A unit room with a lamp on one side of a wall that reaches from floor to ceiling, and is part of the room."""
    vertices, faces, _ = box(divisions=divisions)
    things = [Thing(vertices, faces, 0.7, name="Room")]
    if thickness:
        low, high = 0.47, 0.47 + thickness
        sides = (
            [(low, 0, 0), (low, 0, 1), (low, 1, 1), (low, 1, 0)],
            [(high, 0, 0), (high, 1, 0), (high, 1, 1), (high, 0, 1)],
        )
    else:
        sides = ([(0.47, 0, 0), (0.47, 1, 0), (0.47, 1, 1), (0.47, 0, 1)],)
    things += [Thing(*grid(side, divisions, divisions), 0.7, name="Wall") for side in sides]
    lamp = PointLight(np.array([0.2, 0.5, 0.5]), np.ones(3), radius=0.02)
    return scene_of(*things, lights=[lamp])


@pytest.mark.parametrize("divisions", [7, 16])
@pytest.mark.parametrize(
    ("thickness", "accuracy"),
    [
        (0.0, 0.1),
        (1e-3, 0.1),
        (2e-2, 0.1),
        (2e-2, 0.03),
        (0.0, 0.03),
        (1e-3, 0.03),
    ],
)
def test_no_light_passes_a_wall(thickness, accuracy, divisions):
    scene = divided_room(thickness, divisions)
    light = all_light(bake(scene, accuracy)).mean(axis=1)
    places = np.concatenate([corner_places(scene, mesh) for mesh in range(len(scene.receivers))])
    normals = np.concatenate([mesh.corner_normals for mesh in scene.receivers])
    # Places in the wall itself belong to neither side.
    wall = np.abs(places[:, 0] - 0.47 - thickness / 2) < thickness / 2 + 1e-6
    dark = (places[:, 0] > 0.47 + thickness + 1e-6) & ~wall
    lit = (places[:, 0] < 0.47 - 1e-6) & ~wall
    limit = 0.003 * light[lit].mean()
    assert light[dark].mean() < limit
    # The wall's own dark face, or the only one, whose front looks at the dark side.
    face = wall & (normals[:, 0] > 0.5)
    assert light[face].mean() < limit


def floor_under_a_box(divisions: int = 20):
    floor = grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], divisions, divisions)
    vertices, faces, _ = box((0.4, 0.4, 0.4), 4)
    block = (vertices + np.array([0.31, 0.31, 0.0]), faces[:, ::-1])  # no vertex of the floor lies on its foot
    lamp = PointLight(np.array([0.1, 0.1, 1.0]), np.ones(3))
    return scene_of(Thing(*floor, name="Floor"), Thing(*block, name="Block"), lights=[lamp])


def test_receivers_under_a_box_are_found_and_filled_from_around():
    scene = floor_under_a_box()
    result = bake(scene)
    places = corner_places(scene)
    inside = (np.abs(places[:, :2] - 0.51) < 0.2 - 1e-6).all(axis=1)
    outside = (np.abs(places[:, :2] - 0.51) > 0.2 + 1e-6).any(axis=1)
    buried = result.meshes[0].buried_corners
    assert buried[inside].all()
    assert not buried[outside].any()
    assert result.statistics["buried_receivers"] >= 64
    light = corner_light(result)[:, 0]
    around = ~buried & (np.abs(places[:, :2] - 0.51) < 0.27).all(axis=1)
    # Means of neighbors stay within their range; the edge of the shadow makes that range wide.
    assert light[around].min() <= light[inside].min() and light[inside].max() <= light[around].max()
    # On the side of the lamp no black hole lies under the box.
    front = places[:, :2].max(axis=1) < 0.5 - 1e-6
    assert light[inside & front].min() > 0.5 * light[around & front & outside].mean()


def test_light_next_to_a_box_is_that_of_the_open_floor():
    scene = floor_under_a_box()
    light = corner_light(bake(scene), "direct")[:, 0]
    places = corner_places(scene)
    position, height = np.array([0.1, 0.1, 1.0]), 1.0
    expected = height / np.linalg.norm(position - places, axis=1) ** 3
    # In front of the box nothing stands between the floor and the lamp, however near the box.
    near = (places[:, :2] < 0.3 - 1e-6).any(axis=1)
    near &= (places > 1e-6)[:, :2].all(axis=1) & (places < 1 - 1e-6)[:, :2].all(axis=1)
    front = near & (places[:, :2].max(axis=1) < 0.7)
    np.testing.assert_allclose(light[front], expected[front], rtol=1e-3)


# --- sky ------------------------------------------------------------------------------------------------------------


def test_even_sky_over_an_open_floor_gives_pi_times_its_radiance():
    floor = Thing(*grid([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 6, 6))
    scene = scene_of(floor, sky=Sky(np.array([[[0.5, 1.0, 2.0]]])))
    light = corner_light(bake(scene))
    np.testing.assert_allclose(light, np.broadcast_to(np.pi * np.array([0.5, 1.0, 2.0]), light.shape), rtol=1e-5)


def test_closed_box_under_a_sky_stays_black_inside():
    vertices, faces, _ = box(divisions=6)
    result = bake(scene_of(Thing(vertices, faces), sky=1.0))
    assert not corner_light(result).any()


def cube_outward(divisions=4):
    vertices, faces, _ = box(divisions=divisions)
    return vertices, faces[:, ::-1]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1, -1])
def test_sky_grid_lies_as_its_definition_says(axis, sign):
    # One bright cell of many: a cube's side that faces it gets L * solid angle * cosine, the opposite one nothing.
    bands, columns = 64, 128
    direction = np.zeros(3)
    direction[axis] = sign
    direction += 0.02  # off the borders between cells
    direction /= np.linalg.norm(direction)
    band = int((direction[2] + 1) / 2 * bands)
    column = int(np.arctan2(direction[1], direction[0]) % (2 * np.pi) / (2 * np.pi) * columns)
    radiance = np.zeros((bands, columns, 3))
    # Nine cells, so that the hemisphere's rays meet them often enough to be measured.
    patch = radiance[max(band - 4, 0) : band + 5]
    patch[:, np.arange(column - 4, column + 5) % columns] = 1.0
    low, high = -1 + 2 * max(band - 4, 0) / bands, -1 + 2 * min(band + 5, bands) / bands
    azimuths = 2 * np.pi * (column + np.array([-4, 5])) / columns
    # Irradiance of a surface with normal n is the integral of the direction's n-component over the bright cells.
    z = low + (high - low) * (np.arange(400) + 0.5) / 400
    a = azimuths[0] + (azimuths[1] - azimuths[0]) * (np.arange(400) + 0.5) / 400
    rim = np.sqrt(1 - z**2)
    solid = (high - low) * (azimuths[1] - azimuths[0])
    rays = np.stack([np.outer(rim, np.cos(a)), np.outer(rim, np.sin(a)), np.outer(z, np.ones(400))], axis=-1)
    scene = scene_of(Thing(*cube_outward(), reflectance=0.0), sky=Sky(radiance))
    light = corner_light(bake(scene, 0.01))[:, 0]
    normals = scene.receivers[0].corner_normals
    for side in range(3):
        for way in (1, -1):
            facing = normals[:, side] * way > 0.5
            expected = solid * np.maximum(way * rays[..., side], 0).mean()
            # 660 rays on a patch of 1 to 3 % of them, 200 receivers: the mean is good to about 2 %.
            assert light[facing].mean() == pytest.approx(expected, rel=0.03, abs=1e-3), (side, way)


# --- transparency ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sheets", [(0.5,), (0.5, 0.5), (0.9, 0.3, 0.6), (1.0,), (0.0,)])
def test_sheets_dim_light_by_the_product_of_what_they_let_through(sheets):
    floor = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 6, 6), reflectance=0.0, name="Floor")
    wide = [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)]
    veils = [
        Thing(
            *grid(np.array(wide) + np.array([0, 0, 0.3 + 0.1 * row]), 1, 1),
            reflectance=0.0,
            transmittance=share,
            receives=False,
            name=f"Sheet {row}",
        )
        for row, share in enumerate(sheets)
    ]
    position = np.array([0.0, 0.0, 1.0])
    scene = scene_of(floor, *veils, lights=[PointLight(position, np.ones(3))])
    light = corner_light(bake(scene))[:, 0]
    expected = np.prod(sheets) / np.linalg.norm(position - corner_places(scene), axis=1) ** 3
    np.testing.assert_allclose(light, expected, rtol=2e-3)  # receivers on the border are moved inward by 1e-3


@pytest.mark.parametrize("sky", ["even", "half"])
@pytest.mark.parametrize("sheets", [(0.5,), (0.8, 0.5), (1.0,), (0.0,)])
def test_sheets_dim_the_sky_by_the_product_of_what_they_let_through(sheets, sky):
    floor = Thing(*grid([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], 6, 6), reflectance=0.0, name="Floor")
    # A closed lid on the floor, so that no ray goes past it.
    lids = []
    for row, share in enumerate(sheets):
        vertices, faces, _ = box((4 + row, 4 + row, 1 + row), 1)
        lids.append(
            Thing(
                vertices - ((4 + row) / 2, (4 + row) / 2, (1 + row) / 2),
                faces[:, ::-1],
                reflectance=0.0,
                transmittance=share,
                receives=False,
                name=f"Lid {row}",
            )
        )
    # Bright on one side only, the sky shows whether the chance to pass depends on the direction.
    radiance = np.ones((1, 4, 3)) * (
        [[[1.0], [1.0], [1.0], [1.0]]] if sky == "even" else [[[2.0], [2.0], [0.0], [0.0]]]
    )
    light = corner_light(bake(scene_of(floor, *lids, sky=Sky(radiance)), 0.03))
    # Each receiver spreads one chance over its 384 directions: off by at most a few of them per layer.
    np.testing.assert_allclose(light, np.pi * np.prod(sheets), atol=(0.02 if sky == "even" else 0.04) * np.pi)


def test_translucent_box_under_a_sky_is_a_furnace_too():
    # Walls that reflect 0.4, let 0.5 through and emit the missing tenth of the sky's light keep the light even: what a
    # wall shows is 0.4 H + 0.5 pi L + 0.1 pi L = H. It fails if a wall's reflectance counts twice or not at all.
    vertices, faces, _ = box(divisions=6)
    wall = Thing(vertices, faces, reflectance=0.4, transmittance=0.5, emission=0.1 * np.pi)
    light = corner_light(bake(scene_of(wall, sky=1.0), 0.03))
    # Chance decides per ray whether it passes, and patches keep 4 x 32 of them: 0.6 % of noise per patch.
    np.testing.assert_allclose(light.mean(), np.pi, rtol=2e-3)
    assert relative_rms(light, np.full_like(light, np.pi)) < 0.03


# --- colors ---------------------------------------------------------------------------------------------------------


def test_textured_walls_bounce_what_the_shader_says_of_their_own_triangles():
    vertices, faces, _ = box(divisions=4)
    # Something without area comes first, so that rows of the cleaned surfaces are not those the shader knows.
    nothing = Thing(np.zeros((3, 3)), np.array([[0, 1, 2]]), receives=False)
    scene = scene_of(nothing, Thing(vertices, faces))
    normals = np.cross(*(np.diff(vertices[_triangles(faces)], axis=1).transpose(1, 0, 2)))
    wall = np.concatenate([[0], np.abs(normals).argmax(axis=1) * 2 + (normals.max(axis=1) > 1e-9)])
    reflectance = np.array([0.1, 0.3, 0.5, 0.6, 0.7, 0.9])[wall][:, None].repeat(3, axis=1)
    emission = (wall == 3)[:, None] * np.ones(3)
    plain = replace(scene, surfaces=replace(scene.surfaces, reflectance=reflectance, emission=emission, materials=wall))

    def shader(rows, weights):
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
        assert weights.min() > -1e-4
        return reflectance[rows], emission[rows], np.zeros(len(rows))

    textured = replace(
        plain.surfaces,
        textured=np.ones(len(wall), bool),
        shader=shader,
        reflectance=np.full((len(wall), 3), 0.5),
        materials=np.zeros(len(wall), int),
    )
    light = corner_light(bake(replace(plain, surfaces=textured), 0.03))
    expected = corner_light(bake(plain, 0.03))
    assert expected.std() > 0.05 * expected.mean()
    # Emissive textured triangles stay apart where plain ones are merged: other lights, other patches, each within 3 %.
    assert relative_rms(light, expected) < 0.03


def test_stripes_finer_than_a_patch_bounce_their_mean():
    vertices, faces, _ = box(divisions=4)
    scene = scene_of(Thing(vertices, faces, emission=1.0))
    corners = scene.surfaces.vertices[scene.surfaces.triangles]

    def shader(rows, weights):
        places = np.einsum("nk,nki->ni", weights, corners[rows])
        stripes = np.floor(places.sum(axis=1) * 31) % 2
        return np.repeat((0.2 + 0.6 * stripes)[:, None], 3, axis=1), np.ones((len(rows), 3)), np.zeros(len(rows))

    surfaces = replace(scene.surfaces, textured=np.ones(len(corners), bool), shader=shader)
    light = corner_light(bake(replace(scene, surfaces=surfaces), 0.03))
    # B = 1 + rho H with mean rho 0.5. 16 readings of stripes as wide as a patch leave each patch off by about 0.3 / 4,
    # which shows where a corner sees few patches, and not in the mean.
    np.testing.assert_allclose(light.mean(), 2, rtol=0.01)
    assert relative_rms(light, np.full_like(light, 2)) < 0.06


def test_channels_are_independent():
    scene = cornell_box(8)
    mesh = scene.receivers[0]

    def only(channel):
        mask = np.zeros(3)
        mask[channel] = 1
        surfaces = replace(
            scene.surfaces,
            emission=scene.surfaces.emission * mask,
            reflectance=scene.surfaces.reflectance * mask,
        )
        return replace(
            scene, surfaces=surfaces, receivers=(replace(mesh, palette_emission=mesh.palette_emission * mask),)
        )

    for channel in range(3):
        light = corner_light(bake(only(channel)))
        assert light[:, channel].max() > 0
        assert not np.delete(light, channel, axis=1).any()


def test_light_is_linear_in_emission():
    scene = cornell_box(8)
    double = replace(scene, surfaces=replace(scene.surfaces, emission=8 * scene.surfaces.emission))
    # A power of two changes no rounding: the same bits but for the scale.
    np.testing.assert_array_equal(corner_light(bake(double)), 8 * corner_light(bake(scene)))


def test_direct_and_indirect_are_the_parts_of_lighting():
    result = bake(cornell_box(8))
    parts = corner_light(result, "direct") + corner_light(result, "indirect")
    np.testing.assert_allclose(corner_light(result), parts, rtol=1e-6)
    assert (corner_light(result, "direct") > 0).any() and (corner_light(result, "indirect") > 0).any()


# --- statistics -----------------------------------------------------------------------------------------------------


def test_statistics_count_what_there_is():
    scene = cornell_box(8)
    result = bake(scene)
    statistics = result.statistics
    assert statistics["triangles"] == len(scene.surfaces.triangles)
    assert 12 <= statistics["traced_triangles"] < statistics["triangles"], "flat walls are traced as few triangles"
    receivers = np.unique(result.meshes[0].corner_receivers)
    assert statistics["receivers"] == statistics["elements"] == len(receivers)
    assert statistics["lights"] >= 1
    assert statistics["iterations"] >= 3
    assert statistics["rays"] > 100 * statistics["receivers"]
    assert set(statistics["seconds"]) >= {"prepare", "patches", "direct light", "indirect light", "total"}


def test_progress_never_falls_and_says_what_is_done():
    from radiosity.core.bake import bake_steps
    from radiosity.core.settings import BakeSettings

    steps = list(bake_steps(cornell_box(8), BakeSettings(accuracy=0.1)))
    fractions = [step.fraction for step in steps]
    assert (np.diff(fractions) >= 0).all()
    assert fractions[0] == 0 and fractions[-1] <= 1
    assert all(step.message for step in steps)
    assert len(steps) > 20
