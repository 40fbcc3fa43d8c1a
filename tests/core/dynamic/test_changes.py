"""What differs between two states of the surfaces, told by object."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.dynamic.changes import changes_between
from radiosity.core.scene import Surfaces


def surfaces_of(**objects):
    """One triangle for each name, at the given place; names in the given order."""
    count = len(objects)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) + np.array(list(objects.values()), float)[:, None]
    return Surfaces(
        vertices=corners.reshape(-1, 3),
        triangles=np.arange(3 * count).reshape(-1, 3),
        materials=np.zeros(count, int),
        objects=np.arange(count),
        object_names=list(objects),
        reflectance=np.full((count, 3), 0.5),
        emission=np.zeros((count, 3)),
        transmittance=np.zeros(count),
        two_sided=np.ones(count, bool),
        textured=np.zeros(count, bool),
    )


BEFORE = surfaces_of(wall=(0, 0, 0), chair=(2, 0, 0), lamp=(0, 5, 0))


def test_nothing_changes_where_only_rows_do():
    after = changes_between(BEFORE, surfaces_of(lamp=(0, 5, 0), wall=(0, 0, 0), chair=(2, 0, 0)))
    assert (after.added, after.removed, after.moved, after.recolored) == ((), (), (), ())
    assert after.boxes.shape == (0, 2, 3)


def test_moved_added_and_removed_objects_give_their_places():
    after = changes_between(BEFORE, surfaces_of(wall=(0, 0, 0), chair=(3, 0, 1), table=(7, 0, 0)))
    assert (after.added, after.removed, after.moved, after.recolored) == (("table",), ("lamp",), ("chair",), ())
    places = [(0, 5, 0), (2, 0, 0), (7, 0, 0), (3, 0, 1)]
    np.testing.assert_array_equal(after.boxes, [[place, np.add(place, (1, 1, 0))] for place in places])


@pytest.mark.parametrize("field", ["reflectance", "emission"])
def test_colors_need_no_boxes(field):
    colors = getattr(BEFORE, field).copy()
    colors[1] = 0.7
    after = changes_between(BEFORE, replace(BEFORE, **{field: colors}))
    assert (after.moved, after.recolored, len(after.boxes)) == ((), ("chair",), 0)


@pytest.mark.parametrize(("field", "value"), [("transmittance", 0.5), ("two_sided", False)])
def test_what_blocks_otherwise_counts_as_moved(field, value):
    column = getattr(BEFORE, field).copy()
    column[1] = value
    after = changes_between(BEFORE, replace(BEFORE, **{field: column}))
    assert (after.moved, after.recolored, len(after.boxes)) == (("chair",), (), 2)


def test_an_object_without_triangles_is_no_object():
    empty = replace(BEFORE, object_names=["wall", "chair", "lamp", "empty"])
    assert changes_between(BEFORE, empty).added == ()
