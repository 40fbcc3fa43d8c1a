"""The BSP tree: its order, its segments against plain tests, and the exactness of what is left by clipping."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.form_factors.clipped_quadrature import ClippedQuadrature
from radiosity.core.visibility.bsp import BspTree, BspVisibility

from tests.reference_cases import form_factor_cases, polygons_of

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


def reference_environment(name):
    return core.Environment.from_polygons(polygons_of(form_factor_cases()[name])[0])


def quads(count, seed=1):
    generator = np.random.default_rng(seed)
    origins, sides = generator.random((count, 1, 3)), 0.2 * generator.normal(size=(count, 2, 3))
    first, second = sides[:, :1], sides[:, 1:]
    loops = np.concatenate([origins, origins + first, origins + first + second, origins + second], axis=1)
    return core.Environment.from_polygons(list(loops))


def free_by_triangles(environment, origins, targets):
    """The same answer by every triangle, one after the other."""
    free = np.ones(len(origins), dtype=bool)
    for a, b, c in environment.vertices[environment.triangles]:
        normal = np.cross(b - a, c - a)
        here, there = (origins - a) @ normal, (targets - a) @ normal
        crossing = (here > 0) != (there > 0)
        places = origins + (here / np.where(crossing, here - there, 1))[:, None] * (targets - origins)
        for start, end in ((a, b), (b, c), (c, a)):
            crossing &= np.cross(end - start, places - start) @ normal >= 0
        free &= ~crossing
    return free


@pytest.mark.parametrize("name", ["enc-cornell", "enc-L-room", "enc-box345-1cube", "obs-tri-tilted", None])
def test_segments_agree_with_every_triangle(name):
    environment = quads(60) if name is None else reference_environment(name)
    generator = np.random.default_rng(0)
    low, high = environment.vertices.min(axis=0), environment.vertices.max(axis=0)
    origins, targets = (low + generator.random((5000, 3)) * (high - low) for _ in range(2))
    visibility = BspVisibility(environment)
    free = visibility.visible(origins, targets)
    assert 0.1 < free.mean() < 0.95 and visibility.rays == 5000
    np.testing.assert_array_equal(free, free_by_triangles(environment, origins, targets))
    np.testing.assert_array_equal(visibility.visible(targets, origins), free)


def test_segments_between_surfaces_are_not_blocked_by_their_ends_nor_pass_a_seam():
    cube = reference_environment("enc-cube")
    generator = np.random.default_rng(0)
    points = np.concatenate(
        [polygon[0] + generator.random((50, 2)) @ (polygon[[1, 3]] - polygon[0]) for polygon in cube.polygons]
    )
    assert BspVisibility(cube).visible(points, np.roll(points, 50, axis=0)).all()
    seam = core.Environment.from_polygons([SQUARE, SQUARE + np.array([1, 0, 0])])
    assert not BspVisibility(seam).visible(np.array([[0.7, 0.2, 1]]), np.array([[1.3, 0.8, -1]]))[0]


def test_tree_keeps_all_area_and_parts_space():
    environment = quads(60)
    tree = BspTree.build(environment)
    loops, size = tree.pieces.loops, tree.pieces.size
    areas = np.linalg.norm(np.cross(loops[:, 1:-1] - loops[:, :1], loops[:, 2:] - loops[:, :1]).sum(axis=1), axis=1) / 2
    per_patch = np.bincount(tree.pieces.patches, areas * size**2, len(environment))
    # Splinters within the tree's tolerance of a plane are dropped: that times their length.
    np.testing.assert_allclose(per_patch, environment.areas, rtol=1e-8)
    for node in range(len(tree.normals)):
        for side, child in zip((1, -1), tree.children[node], strict=True):
            if child >= 0:
                below = slice(tree.starts[child], tree.starts[child + 1])
                heights = side * (loops[below] @ tree.normals[node] - tree.offsets[node])
                assert heights.min() > -1e-10


def test_order_from_near_to_far_is_never_contradicted_by_a_segment():
    environment = quads(25)
    tree = BspTree.build(environment)
    generator = np.random.default_rng(3)
    eyes = generator.random((8, 3)) - 0.5
    ranks = tree.ranks(eyes)
    assert (np.sort(ranks, axis=1) == np.arange(len(tree.normals))).all()
    middles = tree.pieces.loops.mean(axis=1)
    for eye, order in zip(eyes, ranks, strict=True):
        for piece, middle in enumerate(middles):
            rays = middle - eye
            heights = tree.offsets - tree.normals @ eye
            shares = heights / (tree.normals @ rays)
            for node in np.flatnonzero((shares > 0) & (shares < 1 - 1e-9)):
                place = eye + shares[node] * rays
                pieces = tree.pieces.loops[tree.starts[node] : tree.starts[node + 1]]
                edges = np.roll(pieces, -1, axis=1) - pieces
                sides = np.einsum("mki,i->mk", np.cross(edges, place - pieces), tree.normals[node])
                if ((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)).any():
                    assert order[node] < order[tree.nodes[piece]]


def test_what_is_left_of_a_half_hidden_square_has_exactly_half_its_area():
    # From below its middle, a plate at half the height that covers x < 1/2 hides the half with x < 1/2.
    light = SQUARE[::-1] + np.array([0, 0, 1])
    plate = np.array([[-1, -1, 0.5], [0.5, -1, 0.5], [0.5, 2, 0.5], [-1, 2, 0.5]])
    quadrature = ClippedQuadrature(core.Environment.from_polygons([light, plate]))
    eye = quadrature.tree.pieces.to_unit(np.array([[0.5, 0.5, 0]]))
    pieces = quadrature.tree.pieces
    target = np.flatnonzero(pieces.patches == 0)
    assert len(target) == 1
    others = np.flatnonzero(pieces.patches == 1)[None]
    fragments = quadrature.clipper.visible(eye, np.array([[0, 0, 1.0]]), target, others)
    rays = fragments.rays
    areas = np.linalg.norm(np.cross(rays[:, 1:-1] - rays[:, :1], rays[:, 2:] - rays[:, :1]).sum(axis=1), axis=1) / 2
    assert areas.sum() * pieces.size**2 == pytest.approx(0.5, abs=1e-14)
    assert ((fragments.rays + eye[0]) * pieces.size + pieces.center)[:, :, 0].min() == pytest.approx(0.5, abs=1e-14)


def test_fragments_seen_and_fragments_hidden_make_the_whole():
    # Every polygon of a closed box hides nothing of the sum: from any point of a furnished box the factors sum to 1.
    environment = reference_environment("enc-box345-1cube")
    quadrature = ClippedQuadrature(environment)
    generator = np.random.default_rng(5)
    low, high = environment.vertices.min(axis=0), environment.vertices.max(axis=0)
    for _ in range(10):
        point, normal = low + generator.random(3) * (high - low), generator.normal(size=3)
        normal /= np.linalg.norm(normal)
        total = sum(quadrature.point(point, normal, patch) for patch in range(len(environment)))
        inside = all(
            (point - environment.polygons[patch][0]) @ environment.normals[patch] < 0 for patch in range(6, 12)
        )
        assert inside or total == pytest.approx(1, abs=1e-12)
