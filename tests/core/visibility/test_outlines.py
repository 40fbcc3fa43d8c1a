"""Outlines: corners and edges once each, and which edges of coplanar polygons never show."""

import numpy as np
from radiosity import core
from radiosity.core.form_factors.critical_lines import critical_lines
from radiosity.core.visibility.bsp import BspTree
from radiosity.core.visibility.outlines import Outlines

from tests.reference_cases import form_factor_cases, polygons_of


def outlines_of(environment):
    return Outlines.build(environment, BspTree.build(environment).pieces)


def test_a_box_has_eight_corners_and_twelve_edges_whose_faces_meet_there():
    environment = core.Environment.from_polygons(polygons_of(form_factor_cases()["enc-cube"])[0])
    outlines = outlines_of(environment)
    assert outlines.corners.shape == (8, 3) and outlines.edges.shape == (12, 2)
    assert np.bincount(outlines.sides).tolist() == [2] * 12
    middles = outlines.corners[outlines.edges].mean(axis=1)
    # Into a face means towards its middle, half an edge away; the two faces of a cube's edge stand at a right angle.
    distances = np.linalg.norm(middles[:, None] + outlines.inward / 2, axis=2)
    np.testing.assert_allclose(distances, 0.5, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ei,ei->e", outlines.inward[:, 0], outlines.inward[:, 1]), 0, atol=1e-12)


def lines_under(plates):
    """Number of critical lines on a floor under a ceiling with plates between."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    flat = [np.column_stack((loop, np.full(len(loop), height))) for loop, height in plates]
    floor, ceiling = np.column_stack((square, np.zeros(4))), np.column_stack((square, np.ones(4)))[::-1]
    environment = core.Environment.from_polygons([floor, ceiling, *flat])
    pieces = BspTree.build(environment).pieces
    loops = [pieces.to_unit(loop)[None] for loop in (floor, ceiling)]
    blockers = np.arange(2, 2 + len(flat))[None]
    return critical_lines(Outlines.build(environment, pieces), np.array([[0.0, 0, 1]]), *loops, np.array([1]), blockers)


def test_a_plate_in_two_parts_makes_the_lines_of_the_whole():
    whole = np.array([[0.3, 0.3], [0.7, 0.3], [0.7, 0.6], [0.3, 0.6]])
    left, right = (whole.clip(low, high) for low, high in (([0.3, 0], [0.5, 1]), ([0.5, 0], [0.7, 1])))
    one, two = (lines_under([(loop, 0.5) for loop in loops]) for loops in ([whole], [left, right]))
    # The parts have two corners more, the ends of the cut, each with the two edges of the ceiling that run across.
    unique = [np.unique(np.round(np.column_stack((a.normals, a.offsets)), 9), axis=0) for a in (one, two)]
    assert {tuple(row) for row in unique[0]} <= {tuple(row) for row in unique[1]}
    cut = two.offsets[np.abs(two.normals[:, 0]) > 0.999]
    assert one.counts[0] > 0 and (np.abs(two.normals[:, 2]) < 1e-12).all()
    assert len(unique[1]) <= len(unique[0]) + 8 and len(cut) > 0
