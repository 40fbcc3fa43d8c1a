"""Light at contacts: as good as within faces, told by the estimate, exact where all is uniform; what a contact is."""

from functools import cache

import numpy as np
import pytest
from radiosity.core.bake_plan import plan_for
from radiosity.core.form_factors.cached_hemispheres import gather
from radiosity.core.gathering.contacts import find_contacts, find_ends
from radiosity.core.gathering.near_field import near_field
from radiosity.core.gathering.receivers import build_receivers
from radiosity.core.lights.direct_light import direct_light
from radiosity.core.progress import finish
from radiosity.core.visibility.embree import Frame, RayPool, Tracer

from tests.bakes import bake, solved_patches
from tests.scenes import box, cornell_box, furnace_box, scene_from_quads

ACCURACIES = (0.1, 0.03)


@cache
def cornell_errors(accuracy, seed):
    """Relative RMS errors within faces, on borders, and of all, and the estimate: against a bake of six times less."""
    scene = cornell_box(20)
    borders = receivers_of(scene).borders
    exact, result = fine_bake(), bake(scene, accuracy, seed=seed)
    mesh = result.meshes[0]
    square = ((mesh.direct + mesh.indirect - exact.direct - exact.indirect).astype(float) ** 2).mean(axis=1)
    usable = ~(mesh.buried | exact.buried)
    mean = (exact.direct + exact.indirect)[usable].mean()
    errors = [np.sqrt(square[usable & part].mean()) / mean for part in (~borders, borders, np.ones_like(borders))]
    return (*errors, result.statistics["estimated_error"])


@cache
def fine_bake():
    return bake(cornell_box(20), 0.005).meshes[0]


def receivers_of(scene):
    return build_receivers(scene.receivers, Frame.around(scene.surfaces.vertices))


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_accuracy_is_kept_at_borders_too(accuracy):
    for seed in (0, 1):
        interior, border, every, _ = cornell_errors(accuracy, seed)
        # Patches as they are looked up would give borders more than three times the error of the rest.
        assert border < 1.7 * interior
        assert every < 1.15 * interior
        assert every < accuracy


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_estimate_tells_the_error_of_all_receivers(accuracy):
    for seed in (0, 1):
        *_, every, estimate = cornell_errors(accuracy, seed)
        assert every / 1.5 < estimate < 1.5 * every


def test_nothing_changes_where_radiosity_is_uniform():
    scene = furnace_box(divisions=4)
    solution, model = solved_patches(scene, 0.1)
    with RayPool(1) as pool:
        receivers = build_receivers(scene.receivers, model.frame)
        points, normals, names = receivers.points, receivers.normals, np.arange(len(receivers))
        seen = finish(gather(solution.tracer, solution.hits_to_rows, points, normals, 128, pool, 3, names))
        alone = np.empty((0, 2), np.int32)
        direct, _ = finish(direct_light(solution.tracer, model.lights, points, normals, alone, 64, pool))
        arriving = seen.irradiance(solution.table())
        work = near_field(solution, points, normals, seen, arriving, direct, plan_for(0.1).indirect.near, 3, names)
        mended, rays = finish(work)
    assert rays > 0
    # The solver stops at 2e-4 of the radiosity, and so does the balance on which the mend rests.
    np.testing.assert_allclose(mended + direct, 2.0, rtol=1e-3)


def crate_in_room():
    """A room of side 4 with a crate of side 1 on its floor, and where its receivers are."""
    room, sides, _ = box((4.0, 4.0, 4.0), 4)
    crate, faces, which = box((1.0, 1.0, 1.0), 4)
    faces = faces[which != 4, ::-1]
    vertices = np.concatenate([room, crate + np.array([1.5, 1.5, 0.0])])
    faces = np.concatenate([sides, faces + len(room)])
    scene = scene_from_quads(vertices, faces, np.zeros(len(faces)), [[0.5] * 3], [[1.0] * 3])
    frame = Frame.around(vertices)
    receivers = build_receivers(scene.receivers, frame)
    return scene, receivers, receivers.points * frame.size + frame.center


def test_contacts_are_borders_beside_which_something_rises():
    scene, receivers, places = crate_in_room()
    frame = Frame.around(scene.surfaces.vertices)
    tracer = Tracer.build(frame.to_unit(scene.surfaces.vertices), scene.surfaces.triangles)
    with RayPool(1) as pool:
        contacts = find_contacts(tracer, receivers, pool)
    of_crate = (np.abs(places[:, :2] - 2) < 0.6).all(axis=1) & (places[:, 2] < 1.1)
    of_crate &= ~((receivers.normals[:, 2] > 0.5) & (places[:, 2] < 0.5))
    room = ~of_crate
    np.testing.assert_array_equal(contacts[room], receivers.borders[room])
    foot = places[:, 2] < 0.01
    np.testing.assert_array_equal(contacts[of_crate], foot[of_crate] & receivers.borders[of_crate])
    ends = find_ends(receivers, contacts)
    # Three at each corner of the room, two at each foot of the crate's four edges.
    assert ends.sum() == 8 * 3 + 4 * 2
