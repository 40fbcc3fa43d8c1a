"""What is left out or mended, and how it is named."""

from dataclasses import replace

import numpy as np
import pytest
from radiosity.core.cleaning import MAX_NAMES, clamped_emission, clamped_reflectance, clean

from tests.bakes import Thing, scene_of
from tests.scenes import box


def surfaces(*things):
    return scene_of(*things).surfaces


def triangle(*corners, **look):
    return Thing(np.array(corners, dtype=float), np.array([[0, 1, 2]]), **look)


SOUND = triangle((0, 0, 0), (1, 0, 0), (0, 1, 0), name="Sound")


def test_sound_surfaces_pass_unchanged():
    vertices, faces, _ = box(divisions=3)
    given = surfaces(Thing(vertices, faces, 0.3, 2.0, transmittance=0.25))
    cleaned = clean(given)
    assert not cleaned.warnings
    np.testing.assert_array_equal(cleaned.rows, np.arange(len(given.triangles)))
    for name in ("vertices", "triangles", "materials", "reflectance", "emission", "transmittance", "two_sided"):
        np.testing.assert_array_equal(getattr(cleaned.surfaces, name), getattr(given, name))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_rows_tell_where_the_kept_triangles_were(value):
    given = surfaces(
        triangle((0, 0, 0), (1, 0, value), (0, 1, 0), name="Not"),
        SOUND,
        triangle((0, 0, 0), (1, 0, 0), (2, 0, 0), name="Line"),
        triangle((5, 0, 0), (6, 0, 0), (5, 1, 0), reflectance=0.25, name="Other"),
    )
    cleaned = clean(given)
    np.testing.assert_array_equal(cleaned.rows, [1, 3])
    np.testing.assert_array_equal(cleaned.surfaces.reflectance[:, 0], [0.5, 0.25])
    np.testing.assert_array_equal(
        cleaned.surfaces.vertices[cleaned.surfaces.triangles], given.vertices[given.triangles[[1, 3]]]
    )
    assert np.isfinite(cleaned.surfaces.vertices).all()
    assert len(cleaned.warnings) == 2
    assert "1 triangles" in cleaned.warnings[0] and "'Not'" in cleaned.warnings[0]
    assert "1 triangles" in cleaned.warnings[1] and "'Line'" in cleaned.warnings[1]


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize(("height", "kept"), [(1e-6, True), (1e-8, False), (0.0, False)])
def test_degenerate_is_judged_by_shape_and_not_by_size(scale, height, kept):
    sliver = np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0]]) * scale
    assert len(clean(surfaces(triangle(*sliver))).rows) == kept


def test_nothing_may_be_left():
    cleaned = clean(surfaces(triangle((0, 0, 0), (0, 0, 0), (0, 0, 0))))
    assert cleaned.surfaces.triangles.shape == (0, 3)
    assert len(cleaned.surfaces.vertices) == 0


def test_impossible_colors_are_clamped_and_named_once():
    things = [
        triangle((0, 0, 0), (1, 0, 0), (0, 1, 0), reflectance=(0.5, 1.5, np.nan), name="Bright"),
        triangle((0, 0, 1), (1, 0, 1), (0, 1, 1), reflectance=-0.5, name="Dark"),
        triangle((0, 0, 2), (1, 0, 2), (0, 1, 2), emission=(np.nan, -1.0, np.inf), name="Glow"),
        triangle((0, 0, 3), (1, 0, 3), (0, 1, 3), transmittance=1.5, name="Glass"),
    ]
    cleaned = clean(surfaces(*things))
    np.testing.assert_array_equal(cleaned.surfaces.reflectance[:2], [[0.5, 0.999, 0.0], [0, 0, 0]])
    assert not cleaned.surfaces.emission.any()
    np.testing.assert_array_equal(cleaned.surfaces.transmittance, [0, 0, 0, 1])
    assert len(cleaned.warnings) == 2
    assert "reflectance" in cleaned.warnings[0] and "'Bright', 'Dark'" in cleaned.warnings[0]
    assert "emission" in cleaned.warnings[1] and "'Glow'" in cleaned.warnings[1]


def test_a_long_list_of_names_is_cut():
    flat = [triangle((0, 0, 0), (1, 0, 0), (2, 0, 0), name=f"Object {row:02}") for row in range(MAX_NAMES + 3)]
    (warning,) = clean(surfaces(SOUND, *flat)).warnings
    assert "and 3 more" in warning and warning.count("'Object") == MAX_NAMES
    assert "'Sound'" not in warning


def test_clamping_leaves_what_is_possible():
    values = np.linspace(0, 0.999, 50)
    np.testing.assert_array_equal(clamped_reflectance(values), values)
    np.testing.assert_array_equal(clamped_emission(values * 1e30), values * 1e30)


def test_colors_of_a_palette_are_mended_and_only_those_worn_are_told():
    line = triangle((0, 0, 0), (1, 0, 0), (2, 0, 0), name="Line")
    given = replace(
        surfaces(SOUND, line, triangle((5, 0, 0), (6, 0, 0), (5, 1, 0), name="Bright")),
        reflectance=np.array([[0.5] * 3, [2.0] * 3, [3.0] * 3]),
        emission=np.zeros((3, 3)),
        transmittance=np.zeros(3),
        palette_rows=np.array([0, 2, 1], np.uint8),
    )
    cleaned = clean(given)
    np.testing.assert_array_equal(cleaned.surfaces.palette_rows, [0, 1])
    np.testing.assert_array_equal(cleaned.surfaces.reflectance[cleaned.surfaces.palette_rows, 0], [0.5, 0.999])
    told = [line for line in cleaned.warnings if "reflectance" in line]
    assert len(told) == 1 and "'Bright'" in told[0] and "'Line'" not in told[0]
