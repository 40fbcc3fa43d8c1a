"""Binary subdivision: limits, halves, balance, neighbors, and triangles without gaps."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.discretization.conforming import conforming_mesh
from radiosity.core.discretization.hierarchy import Hierarchy, SubdivisionLimits
from radiosity.core.errors import SceneTooLargeError, SettingsError

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
BESIDE = SQUARE + np.array([1, 0, 0])
WALL = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], dtype=float)
TRIANGLE = np.array([[0, 0, 1], [1, 0, 1], [0.3, 0.8, 1]], dtype=float)
CONCAVE = np.array([[0, 0, 2], [2, 0, 2], [2, 1, 2], [1, 1, 2], [1, 2, 2], [0, 2, 2]], dtype=float)


def build(polygons, **limits):
    limits = {"patch_max": 1000, "patch_min": 1, "element_max": 250, "element_min": 1} | limits
    return Hierarchy.build(core.Environment.from_polygons(polygons), SubdivisionLimits(**limits))


def refined_towards(hierarchy, place, rounds=6, share=5):
    """Halve the elements nearest to a place again and again."""
    for _ in range(rounds):
        distances = np.linalg.norm(hierarchy.corners[hierarchy.elements].mean(axis=1) - place, axis=1)
        nearest = hierarchy.elements[np.argsort(distances, kind="stable")]
        hierarchy = hierarchy.refined(nearest[: max(1, len(nearest) // share)])
    return hierarchy


def test_square_is_quartered_by_two_halvings():
    # The scene is one unit long: size 1000 is half of it, so patches are of 1 / 4 and elements of 1 / 64.
    hierarchy = build([SQUARE])
    assert len(hierarchy.patch_nodes) == 4 and len(hierarchy.elements) == 64
    assert hierarchy.areas[hierarchy.patch_nodes].tolist() == [0.25] * 4
    assert np.bincount(hierarchy.patches[hierarchy.elements]).tolist() == [16] * 4
    patches = hierarchy.polygons(hierarchy.patch_nodes)
    lows = sorted(tuple(polygon.min(axis=0)[:2]) for polygon in patches.polygons)
    assert lows == [(0, 0), (0, 0.5), (0.5, 0), (0.5, 0.5)]


def test_children_partition_their_parent():
    hierarchy = refined_towards(build([SQUARE, TRIANGLE, CONCAVE]), (0.1, 0.1, 0))
    inner = np.flatnonzero(hierarchy.children[:, 0] >= 0)
    children = hierarchy.children[inner]
    np.testing.assert_allclose(hierarchy.areas[children], hierarchy.areas[inner, None] / [2, 2], rtol=1e-9)
    assert (hierarchy.parents[children] == inner[:, None]).all()
    assert (hierarchy.surfaces[children] == hierarchy.surfaces[inner, None]).all()
    total = np.bincount(hierarchy.surfaces[hierarchy.elements], hierarchy.areas[hierarchy.elements])
    np.testing.assert_allclose(total, hierarchy.environment.areas, rtol=1e-12)
    normals = hierarchy.polygons(hierarchy.elements).normals
    np.testing.assert_allclose(
        normals, hierarchy.environment.normals[hierarchy.surfaces[hierarchy.elements]], atol=1e-12
    )


@pytest.mark.parametrize("sizes", [(500, 200, 100, 20), (300, 290, 50, 45), (1000, 1000, 1000, 1000)])
def test_sizes_are_kept(sizes):
    names = ("patch_max", "patch_min", "element_max", "element_min")
    hierarchy = build([SQUARE, TRIANGLE, CONCAVE], **dict(zip(names, sizes, strict=True)))
    patch_max, patch_min, element_max, element_min = (hierarchy.area_of(size) * (1 + 1e-6) for size in sizes)
    for nodes, most, least in (
        (hierarchy.patch_nodes, patch_max, patch_min),
        (hierarchy.elements, element_max, element_min),
    ):
        areas = hierarchy.areas[nodes]
        # What is still too large could not be halved without falling below the least size.
        assert ((areas <= most) | (areas < 2 * least)).all()
        made = nodes[hierarchy.parents[nodes] >= 0]
        before = hierarchy.areas[hierarchy.parents[made]]
        assert (before * (1 + 1e-6) >= 2 * least / (1 + 1e-6)).all()


def test_number_of_elements_is_kept_and_largest_are_halved_first():
    whole = build([SQUARE], element_max=60)
    for most in (5, 17, 100):
        hierarchy = build([SQUARE], element_max=60, max_elements=most)
        assert len(hierarchy.elements) == most < len(whole.elements)
        areas = hierarchy.areas[hierarchy.elements]
        assert areas.max() <= 2 * areas.min()
    with pytest.raises(SceneTooLargeError, match="4 patches are more than max_elements, 3"):
        build([SQUARE], max_elements=3)


def test_size_does_not_depend_on_unit_or_place():
    for scale, shift in ((1e-3, 0.0), (1e4, 0.0), (1.0, 1000.0)):
        moved = build([scale * SQUARE + shift, scale * TRIANGLE + shift])
        assert len(moved.elements) == len(build([SQUARE, TRIANGLE]).elements)


def test_degenerate_surfaces_are_left_out():
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], dtype=float)
    with pytest.warns(UserWarning, match="without area"):
        hierarchy = build([line, SQUARE])
    assert set(hierarchy.surfaces.tolist()) == {1}


@pytest.mark.parametrize("name", ["patch_max", "patch_min", "element_max", "element_min"])
def test_sizes_of_nothing_are_refused(name):
    with pytest.raises(SettingsError, match=f"{name} must be above 0"):
        SubdivisionLimits(**{name: 0})
    with pytest.raises(SettingsError, match="max_elements must be 1 or more"):
        SubdivisionLimits(max_elements=0)


def brute_force_neighbors(hierarchy):
    """Pairs of coplanar elements whose sides overlap, by comparing all."""
    pairs = []
    corners, elements = hierarchy.corners[hierarchy.elements], hierarchy.elements
    normals = hierarchy.environment.normals[hierarchy.surfaces[elements]]

    def sides(loop):
        ends = np.roll(loop, -1, axis=0)
        return [(a, b) for a, b in zip(loop, ends, strict=True) if not np.array_equal(a, b)]

    for one in range(len(elements)):
        for other in range(one + 1, len(elements)):
            if normals[one] @ normals[other] < 0.999:
                continue
            for a, b in sides(corners[one]):
                along, length = (b - a) / np.linalg.norm(b - a), np.linalg.norm(b - a)
                for c, d in sides(corners[other]):
                    off = [np.linalg.norm(np.cross(p - a, along)) for p in (c, d)]
                    low, high = sorted(((c - a) @ along, (d - a) @ along))
                    if max(off) < 1e-9 and min(high, length) - max(low, 0) > 1e-9:
                        pairs.append((one, other))
    return np.unique(np.array(pairs), axis=0)


@pytest.mark.parametrize("polygons", [[SQUARE], [SQUARE, BESIDE, WALL], [TRIANGLE, CONCAVE]])
def test_neighbors_are_those_whose_sides_overlap(polygons):
    hierarchy = refined_towards(build(polygons, element_max=600), (0.3, 0.2, 1), rounds=4)
    np.testing.assert_array_equal(hierarchy.neighbors(), brute_force_neighbors(hierarchy))


def vertices_on_sides(hierarchy):
    """Largest number of corners of others inside any side of an element, by comparing all."""
    starts, ends, _ = hierarchy.sides(hierarchy.elements)
    corners = np.unique(starts, axis=0)
    along = ends - starts
    places = (
        np.einsum("sci,si->sc", corners[None] - starts[:, None], along) / np.einsum("si,si->s", along, along)[:, None]
    )
    off = np.linalg.norm(corners[None] - starts[:, None] - places[:, :, None] * along[:, None], axis=2)
    return int(((off < 1e-9) & (places > 1e-9) & (places < 1 - 1e-9)).sum(axis=1).max())


@pytest.mark.parametrize("polygons", [[SQUARE], [SQUARE, BESIDE, WALL], [TRIANGLE, CONCAVE]])
def test_refinement_stays_balanced_also_across_surfaces(polygons):
    hierarchy = refined_towards(build(polygons, element_max=600), (0.9, 0.1, 0), rounds=7, share=12)
    assert vertices_on_sides(hierarchy) == 1
    areas = hierarchy.areas[hierarchy.elements]
    assert areas.max() > 8 * areas.min()


def test_refinement_keeps_least_size_and_number():
    hierarchy = build([SQUARE], element_max=500, element_min=240, max_elements=30)
    hierarchy = refined_towards(hierarchy, (0, 0, 0), rounds=10, share=1)
    assert len(hierarchy.elements) <= 30
    # Balance alone may go below the least size, by one halving at most here.
    assert hierarchy.areas.min() >= hierarchy.area_of(240) / 2


@pytest.mark.parametrize("polygons", [[SQUARE], [SQUARE, BESIDE, WALL], [TRIANGLE, CONCAVE]])
def test_triangles_leave_no_gaps(polygons):
    hierarchy = refined_towards(build(polygons, element_max=600), (0.9, 0.1, 0), rounds=7, share=12)
    mesh = conforming_mesh(hierarchy)
    np.testing.assert_allclose(np.bincount(mesh.elements, mesh.areas), hierarchy.areas[hierarchy.elements], rtol=1e-9)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = hierarchy.environment.normals[hierarchy.surfaces[hierarchy.elements[mesh.elements]]]
    assert (np.einsum("ti,ti->t", normals, facing) > 1e-12).all()
    # A side belongs to two triangles, or lies on its surface's border: where it does, no vertex lies inside it.
    sides = np.sort(np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    sides, counts = np.unique(sides, axis=0, return_counts=True)
    assert counts.max() == 2
    single = sides[counts == 1]
    length = np.linalg.norm(mesh.vertices[single[:, 1]] - mesh.vertices[single[:, 0]], axis=1).sum()
    loops = [np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).sum() for polygon in polygons]
    assert length == pytest.approx(sum(loops), rel=1e-9)
    starts, along = mesh.vertices[sides[:, 0]], mesh.vertices[sides[:, 1]] - mesh.vertices[sides[:, 0]]
    places = np.unique(mesh.vertices, axis=0)
    reach = np.einsum("vsi,si->vs", places[:, None] - starts, along) / np.einsum("si,si->s", along, along)
    off = np.linalg.norm(places[:, None] - starts - reach[:, :, None] * along, axis=2)
    assert not ((off < 1e-9) & (reach > 1e-9) & (reach < 1 - 1e-9)).any()


def test_vertex_values_are_means_of_the_elements_around():
    hierarchy = refined_towards(build([SQUARE, WALL], element_max=600), (0.9, 0.1, 0))
    mesh = conforming_mesh(hierarchy)
    surfaces = hierarchy.surfaces[hierarchy.elements].astype(float)
    values = mesh.vertex_values(np.column_stack((surfaces, np.full(len(surfaces), 0.7))))
    # Surfaces do not mix, though they meet.
    np.testing.assert_allclose(values, np.column_stack((mesh.surfaces, np.full(len(mesh.surfaces), 0.7))), rtol=1e-12)
    single = build([SQUARE], patch_max=2000, element_max=1000)
    x = single.corners[single.elements].mean(axis=1)[:, :1]
    flat = conforming_mesh(single)
    inner = (np.abs(flat.vertices[:, :2] - 0.5) < 0.1).all(axis=1)
    assert inner.sum() == 1 and flat.vertex_values(x)[inner] == pytest.approx(0.5)
