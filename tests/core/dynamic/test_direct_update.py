"""Direct light after a move: equal to the full computation, with fewer rays."""

import numpy as np
import pytest
from radiosity.core.dynamic.direct_update import receivers_in_reach, updated_direct_light
from radiosity.core.lights import AreaLight
from radiosity.core.lights.mesh import MeshLight
from radiosity.core.progress import finish
from radiosity.core.visibility.embree import RayPool

from tests.core.lights.test_direct_light import LIGHTS, PLATE, SQUARE, floor, run, tracer_of

TRIANGLES = SQUARE[[[0, 1, 2], [0, 2, 3]]]
ALL = LIGHTS | {
    "mesh": MeshLight(TRIANGLES, np.ones(2), np.array([1.0, 2.0, 3.0])),
    # Three corners: near points are lit from places on the rectangle around it, beyond its own border.
    "triangle": AreaLight(SQUARE[:3], np.ones(3)),
}
every_light = pytest.mark.parametrize("light", ALL.values(), ids=ALL.keys())
MOVED = PLATE + np.array([0.25, 0.2, -0.05])
RAYS = 64


def slats(step, width):
    """Slats that stay and are so thin that scouts pass them by: what is found of their shade depends on neighbors."""
    left = np.arange(-0.5, 0.5, step)
    return [np.array([(x, -0.5, 0.3), (x, 0.5, 0.3), (x + width, 0.5, 0.3), (x + width, -0.5, 0.3)]) for x in left]


def boxes_of(*quads):
    return np.array([[quad.min(axis=0), quad.max(axis=0)] for quad in quads])


@every_light
def test_ends_hold_all_segments(light):
    points, normals, _ = floor()
    low, high = light.ends(points.astype(float))
    for segments in (light.aim(points, normals, RAYS)[0], light.scout(points)):
        ends = points[:, None] + segments
        # Rounding of float32 points of size 1 and of segments of length 8.
        assert (ends >= low[:, None] - 1e-5).all()
        assert (ends <= high[:, None] + 1e-5).all()


# Few slats tell the neighbors of reached receivers, many the neighbors of those.
@pytest.mark.parametrize(("step", "width", "divisions"), [(0.25, 0.01, 60), (0.07, 0.02, 30)])
@every_light
def test_a_moved_plate_gives_what_a_full_pass_gives(light, step, width, divisions):
    static = slats(step, width)
    points, normals, edges = floor(divisions)
    before, _ = run(tracer_of(PLATE, *static), [light], points, normals, edges, RAYS)
    full, all_rays = run(tracer_of(MOVED, *static), [light], points, normals, edges, RAYS)
    with RayPool(1) as pool:
        work = updated_direct_light(
            tracer_of(MOVED, *static), [light], points, normals, edges, RAYS, pool, before,
            np.zeros(len(points), bool), boxes_of(PLATE, MOVED),
        )  # fmt: skip
        updated, rays = finish(work)
    assert (before != full).any()
    # The same rays and closed forms, in batches of other lengths: rounding in float32.
    np.testing.assert_allclose(updated, full, rtol=1e-5, atol=1e-6 * full.max())
    assert 0 < rays < all_rays


def test_far_from_all_ways_nothing_is_asked_again():
    points, normals, edges = floor()
    light = LIGHTS["sphere"]
    before, _ = run(tracer_of(), [light], points, normals, edges, RAYS)
    aside = boxes_of(PLATE + np.array([2.0, 0, 0]))
    with RayPool(1) as pool:
        assert not receivers_in_reach([light], points, normals, aside, pool).any()
        nowhere = np.zeros(len(points), bool)
        work = updated_direct_light(
            tracer_of(), [light], points, normals, edges, RAYS, pool, before, nowhere, aside
        )  # fmt: skip
        updated, rays = finish(work)
        assert rays == 0
        np.testing.assert_array_equal(updated, before)
        # Fresh receivers are asked whatever stands elsewhere.
        fresh = np.arange(len(points)) == 7
        work = updated_direct_light(
            tracer_of(), [light], points, normals, edges, RAYS, pool, np.where(fresh[:, None], 9, before), fresh, aside
        )
        updated, rays = finish(work)
    assert rays > 0
    np.testing.assert_allclose(updated, before, rtol=1e-5)
