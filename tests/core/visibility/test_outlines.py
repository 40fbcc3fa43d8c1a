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
    left, right = (whole.clip(low, high) for low, high in (([0.3, 0], [0.55, 1]), ([0.55, 0], [0.7, 1])))
    one, two = (
        np.round(np.column_stack((lines.normals, lines.offsets)), 9) + 0.0
        for lines in (lines_under([(loop, 0.5) for loop in loops]) for loops in ([whole], [left, right]))
    )
    assert len(one) >= 8 and {tuple(row) for row in one} <= {tuple(row) for row in two}
    # The cut's two ends are corners, and each makes a line with the ceiling's edge at x = 1, at 0.4 from the middle;
    # the cut itself, seen through the ceiling's two corners there, would make two more.
    assert ((np.abs(two[:, 0]) > 0.999) & (np.abs(np.abs(two[:, 3]) - 0.4) < 1e-6)).sum() == 2
