"""All visibilities against brute force, on scenes of every kind."""

import numpy as np
import pytest
from radiosity import core
from radiosity.core.errors import SettingsError
from radiosity.core.form_factors.sampling import PatchSampler
from radiosity.core.visibility.brute_force import BruteForce
from radiosity.core.visibility.segments import VISIBILITIES, make_visibility

from tests.reference_cases import form_factor_cases, polygons_of

SCENES = ("enc-cornell", "enc-L-room", "enc-facet-8", "enc-box345-1cube", "obs-shapiro", "obs-tri-tilted")
#: Angle within which a polygon's edge, or a surface that a segment leaves or reaches, counts as grazed: embree rounds to
#: float32 and starts 1e-5 off; the z-buffer has pixels of half a degree, seen from farther away by a corner's slant.
GRAZING = {"embree": 1e-3, "zbuffer": 0.02}


def environment_of(name):
    return core.Environment.from_polygons(polygons_of(form_factor_cases()[name])[0])


def segments(environment, seed, origins=40, targets=50):
    """Ends of segments between random points of the patches, several from each origin."""
    generator = np.random.default_rng(seed)
    usable = np.flatnonzero(environment.areas > 0)
    first, last = generator.choice(usable, origins), generator.choice(usable, origins * targets)
    sampler = PatchSampler(environment)
    starts = sampler(first, generator.random((origins, 1, 2)))[:, 0]
    ends = sampler(last, generator.random((origins * targets, 1, 2)))[:, 0]
    starts, first = np.repeat(starts, targets, axis=0), np.repeat(first, targets)
    # Below a slope of 1e-2 the margin of 1e-5 rises less than float32 resolves, so embree may meet the surface itself.
    directions = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    rising = [np.abs(np.einsum("ki,ki->k", directions, environment.normals[rows])) > 1e-2 for rows in (first, last)]
    return starts[rising[0] & rising[1]], ends[rising[0] & rising[1]]


def steady(environment, origins, targets, angle, seed):
    """Answers of brute force, and where they hold if the targets move about by an angle."""
    reference = BruteForce(environment)
    answers = reference.visible(origins, targets)
    firm = np.ones(len(answers), bool)
    along = targets - origins
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    generator = np.random.default_rng(seed)
    for _ in range(24):
        aside = np.cross(along, generator.normal(size=along.shape))
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-300)
        # Behind its own surface a target would hide: move it toward the origin by as much.
        moved = targets + angle * lengths * aside - 2 * angle * along
        firm &= reference.visible(origins + angle * along, moved) == answers
    return answers, firm


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("visibility", GRAZING)
def test_every_visibility_agrees_with_brute_force(visibility, name):
    environment = environment_of(name)
    origins, targets = segments(environment, 5)
    answers, firm = steady(environment, origins, targets, GRAZING[visibility], 6)
    assert firm.mean() > 0.5 and 0 < answers[firm].mean()
    other = make_visibility(visibility, environment)
    np.testing.assert_array_equal(other.visible(origins, targets)[firm], answers[firm])
    assert other.rays == len(origins)


@pytest.mark.parametrize("visibility", ["embree", "zbuffer", "brute_force"])
def test_a_plate_blocks_what_passes_it_and_nothing_else(visibility):
    floor = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    plate = 0.5 * floor + [0.25, 0.25, 0.5]
    environment = core.Environment.from_polygons([floor, floor[::-1] + [0, 0, 1], plate])
    origins = np.array([[0.5, 0.5, 0], [0.1, 0.1, 0], [0.1, 0.1, 0], [0.5, 0.5, 0], [0.5, 0.5, 1], [0.3, 0.3, 0]])
    targets = np.array([[0.5, 0.5, 1], [0.1, 0.1, 1], [0.9, 0.9, 1], [0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [0.9, 0.3, 0]])
    seen = make_visibility(visibility, environment).visible(origins, targets)
    np.testing.assert_array_equal(seen, [False, True, False, True, True, True])


@pytest.mark.parametrize("scale, shift", [(1e-5, 0), (1e5, 0), (1, 1e4)])
@pytest.mark.parametrize("visibility", ["embree", "zbuffer", "brute_force"])
def test_scale_and_place_do_not_matter(visibility, scale, shift):
    environment = environment_of("enc-facet-8")
    there = core.Environment.from_polygons([loop * scale + shift for loop in environment.polygons])
    origins, targets = segments(environment, 1)
    answers, firm = steady(environment, origins, targets, GRAZING.get(visibility, 1e-6), 2)
    seen = make_visibility(visibility, there).visible(origins * scale + shift, targets * scale + shift)
    np.testing.assert_array_equal(seen[firm], answers[firm])


def test_brute_force_has_no_gap_between_triangles():
    # Segments through the diagonal and through the shared edges of a tiled plane.
    tile = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) / 3
    tiles = [tile + [i / 3, j / 3, 0] for i in range(3) for j in range(3)]
    environment = core.Environment.from_polygons(tiles)
    generator = np.random.default_rng(0)
    share = generator.random(3000)
    through = np.stack((share, np.where(np.arange(3000) % 2, share, 1 / 3), np.zeros(3000)), axis=1)
    slant = generator.normal(size=(3000, 3)) * [1, 1, 0] + [0, 0, 1]
    assert not make_visibility("brute_force", environment).visible(through - slant, through + slant).any()


def test_where_nothing_blocks_everything_is_visible():
    environment = environment_of("enc-cornell")
    free = make_visibility("none", environment)
    assert free.visible(*segments(environment, 0)).all() and free.rays == 0
    empty = core.Environment.from_polygons([np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)])
    above = np.array([[0.1, 0.1, 0.5], [0.1, 0.1, 0.5]])
    for name in VISIBILITIES:
        assert make_visibility(name, empty).visible(above, above + [[0, 0, 1], [0, 0, 0]]).all()


def test_unknown_choices_are_refused_with_what_exists():
    environment = environment_of("enc-facet-8")
    with pytest.raises(SettingsError, match="Unknown visibility 'magic': choose none, embree"):
        make_visibility("magic", environment)
    with pytest.raises(SettingsError, match="Unknown option 'resolution' of visibility embree, it has none"):
        make_visibility("embree", environment, resolution=3)
    with pytest.raises(SettingsError, match="Unknown option 'size' of visibility zbuffer: choose resolution"):
        make_visibility("zbuffer", environment, size=3)
    with pytest.raises(SettingsError, match="whole number of 1 or more"):
        make_visibility("zbuffer", environment, resolution=0)
