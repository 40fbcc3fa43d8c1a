"""Suns found in a picture of the sky."""

import numpy as np
import pytest
from radiosity.core.lights.sky_suns import MOST, bright_places, find_suns

ROWS = 256


def sky_grid():
    """Directions (ROWS, 2 ROWS, 3) and solid angles (ROWS, 2 ROWS) of an equirectangular picture."""
    edges = np.linspace(-np.pi / 2, np.pi / 2, ROWS + 1)
    elevation = (edges[1:] + edges[:-1]) / 2
    azimuth = (np.arange(2 * ROWS) + 0.5) * np.pi / ROWS
    level = np.cos(elevation)[:, None]
    directions = np.stack(
        [
            level * np.cos(azimuth),
            level * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation)[:, None], (ROWS, 2 * ROWS)),
        ],
        axis=2,
    )
    return directions, np.broadcast_to((np.diff(np.sin(edges)) * np.pi / ROWS)[:, None], (ROWS, 2 * ROWS))


def suns_of(radiance):
    directions, solid = sky_grid()
    mean = (radiance * solid[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
    places = bright_places(radiance, mean)
    return find_suns(directions[places], radiance[places], solid[places], mean), mean


def with_disks(*disks, background=0.4):
    """A gray sky with disks of (direction, angle across, radiance)."""
    directions, _ = sky_grid()
    radiance = np.full((*directions.shape[:2], 3), background)
    for direction, angle, level in disks:
        radiance[directions @ (np.asarray(direction) / np.linalg.norm(direction)) > np.cos(angle / 2)] = level
    return radiance


def test_a_disk_becomes_a_sun_of_its_place_size_and_power():
    toward, across = np.array([0.5, 0.3, 0.7]), np.radians(5)
    radiance = with_disks((toward, across, (900.0, 800.0, 500.0)))
    (sun,), mean = suns_of(radiance)
    directions, solid = sky_grid()
    taken = sun.taken_out(directions, radiance)
    assert taken.max() == pytest.approx(mean.max())
    # Every watt once.
    np.testing.assert_allclose(((radiance - taken) * solid[..., None]).sum(axis=(0, 1)), sun.light.irradiance)
    assert sun.light.direction @ toward / np.linalg.norm(toward) > np.cos(np.pi / ROWS)
    # The disk is made of 40 texels: as many by a quarter more or less lie along its rim.
    assert sun.light.angle == pytest.approx(across, rel=0.1)


def test_two_suns_are_told_apart_and_a_faint_one_stays():
    radiance = with_disks(((0, 0.6, 0.8), 0.05, 3000), ((0.8, 0, 0.6), 0.05, 2000), ((-1, 0, 0.1), 0.05, 20))
    suns, _ = suns_of(radiance)
    assert len(suns) == 2
    assert suns[0].light.power[0] > suns[1].light.power[0]


def test_wide_and_long_lights_stay_in_the_sky():
    directions, _ = sky_grid()
    assert not suns_of(with_disks(((0, 0, 1), 1.2, 30)))[0]
    strip = with_disks()
    strip[
        (np.abs(directions[..., 2] - 0.3) < 0.01) & (np.abs(np.arctan2(directions[..., 1], directions[..., 0])) < 1)
    ] = 500
    assert not suns_of(strip)[0]


def test_an_even_sky_has_no_sun():
    assert suns_of(with_disks())[0] == []
    assert suns_of(with_disks(background=0.0))[0] == []


def test_a_sky_of_stars_has_few():
    generator = np.random.default_rng(0)
    stars = [(direction, 0.03, 1000) for direction in generator.normal(size=(40, 3))]
    assert len(suns_of(with_disks(*stars))[0]) <= MOST
