"""Nodes: nested clusters of receivers, joined along the surface and never across a cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from radiosity.core.discretization.nodes import MAX_NEIGHBORS, build_levels, connected_labels
from radiosity.core.gathering.receivers import build_receivers
from radiosity.core.visibility.embree import Frame

from tests.bakes import Thing, receiver_of
from tests.scenes import cornell_box, grid, inward_sphere


def components(count, edges):
    """Lowest member of each item's connected part, by walking."""
    around = [[] for _ in range(count)]
    for a, b in edges:
        around[a].append(b)
        around[b].append(a)
    labels = [-1] * count
    for start in range(count):
        if labels[start] >= 0:
            continue
        labels[start], ahead = start, [start]
        while ahead:
            for other in around[ahead.pop()]:
                if labels[other] < 0:
                    labels[other] = start
                    ahead.append(other)
    return labels


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 40).flatmap(lambda n: st.tuples(st.just(n), st.lists(st.tuples(*[st.integers(0, n - 1)] * 2)))))
def test_labels_are_those_of_a_walk(graph):
    count, pairs = graph
    edges = np.array(pairs, np.int32).reshape(-1, 2)
    np.testing.assert_array_equal(connected_labels(count, edges), components(count, pairs))


@pytest.mark.parametrize("order", [1, -1, 7919])
def test_a_long_chain_is_one_part_in_any_order(order):
    count = 20_000
    items = (np.arange(count) * order) % count if order > 1 else np.arange(count)[::order]
    edges = np.stack([items[:-1], items[1:]], axis=1).astype(np.int32)
    assert (connected_labels(count, edges) == 0).all()


def receivers_of(name):
    mesh = {"room": cornell_box(24), "sphere": inward_sphere(24)}[name].receivers[0]
    return build_receivers([mesh], Frame.around(mesh.positions))


@pytest.mark.parametrize("name", ["room", "sphere"])
def test_levels_are_nested_and_cover_everything(name):
    receivers = receivers_of(name)
    levels = build_levels(receivers.points, receivers.normals, receivers.edges, 0.4, 4)
    assert [level.spacing for level in levels] == [0.4, 0.2, 0.1, 0.05]
    counts = [len(level.nodes) for level in levels]
    assert counts == sorted(counts) and counts[0] < len(receivers) / 20
    for coarse, fine in zip(levels, [*levels[1:], None], strict=True):
        items = np.arange(len(receivers)) if fine is None else fine.nodes
        assert len(coarse.clusters) == len(items)
        # Every cluster has members, and its node is one of them: a node of every finer level.
        np.testing.assert_array_equal(np.unique(coarse.clusters), np.arange(len(coarse.nodes)))
        where = {int(receiver): row for row, receiver in enumerate(items)}
        own = [coarse.clusters[where[int(node)]] for node in coarse.nodes]
        np.testing.assert_array_equal(own, np.arange(len(coarse.nodes)))
        # Members lie in one cell of the grid.
        apart = receivers.points[items] - receivers.points[coarse.nodes[coarse.clusters]]
        assert np.abs(apart).max() < coarse.spacing
        alike = np.einsum("ij,ij->i", receivers.normals[items], receivers.normals[coarse.nodes[coarse.clusters]])
        assert alike.min() > 0.3
        assert coarse.neighbors.shape == (len(coarse.nodes), MAX_NEIGHBORS)


@pytest.mark.parametrize("name", ["room", "sphere"])
def test_clusters_are_connected_within_themselves(name):
    receivers = receivers_of(name)
    (level,) = build_levels(receivers.points, receivers.normals, receivers.edges, 0.2, 1)
    clusters, edges = level.clusters, receivers.edges
    within = edges[clusters[edges[:, 0]] == clusters[edges[:, 1]]]
    labels = connected_labels(len(receivers), within)
    # Two receivers of one cluster have one label, so there are as many labels as clusters.
    assert len(np.unique(labels)) == len(level.nodes)
    # Neighbors are the clusters that an edge leads to.
    pairs = {(int(a), int(b)) for a, b in np.sort(clusters[edges], axis=1) if a != b}
    assert {(int(a), int(b)) for a, b in level.edges} == pairs
    listed = {
        tuple(sorted((row, int(other))))
        for row in range(len(level.nodes))
        for other in level.neighbors[row]
        if other != row
    }
    assert listed <= pairs
    crowded = np.bincount(level.edges.ravel(), minlength=len(level.nodes)).max()
    assert crowded > MAX_NEIGHBORS or listed == pairs


def test_no_cluster_reaches_across_cut_edges():
    mesh = receiver_of(Thing(*grid([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], 41, 41)))
    receivers = build_receivers([mesh], Frame.around(mesh.positions))
    side = receivers.points[:, 0] > 0.013  # off the grid of any level
    edges = receivers.edges[side[receivers.edges[:, 0]] == side[receivers.edges[:, 1]]]
    for level in build_levels(receivers.points, receivers.normals, edges, 0.4, 3)[-1:]:
        lowest = np.full(len(level.nodes), 2)
        highest = np.full(len(level.nodes), -1)
        np.minimum.at(lowest, level.clusters, side)
        np.maximum.at(highest, level.clusters, side)
        np.testing.assert_array_equal(lowest, highest)
        node_side = side[level.nodes]
        np.testing.assert_array_equal(node_side[level.neighbors], np.repeat(node_side[:, None], MAX_NEIGHBORS, axis=1))


def test_one_receiver_and_no_edges():
    (level,) = build_levels(
        np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32), np.empty((0, 2), int), 1, 1
    )
    assert level.nodes.tolist() == [0] and (level.neighbors == 0).all()
