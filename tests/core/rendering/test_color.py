import numpy as np
import pytest
from radiosity.core.rendering.color import (
    LUMINANCE_WEIGHTS,
    compress_highlights,
    dither_to_bytes,
    exposure_scale,
    linear_to_srgb,
    luminance,
    srgb_to_linear,
)


def test_luminance_of_white_is_one_and_of_primaries_their_weight():
    assert luminance(np.ones(3)) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(luminance(np.eye(3)), LUMINANCE_WEIGHTS)


def test_srgb_encoding_matches_the_standard():
    # Values of IEC 61966-2-1: middle gray, the joint of both branches, the ends.
    linear = np.array([0.0, 0.0031308, 0.2140411, 1.0])
    np.testing.assert_allclose(linear_to_srgb(linear), [0, 0.04045, 0.5, 1], atol=1e-5)


def test_srgb_decoding_inverts_encoding():
    encoded = np.linspace(0, 1, 1001)
    # The standard's two branches meet only to 1e-5 or so.
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(encoded)), encoded, atol=1e-6)


def test_highlights_keep_their_order_and_never_pass_white():
    values = np.concatenate([np.linspace(0, 5, 2000), [1e3, 1e6, np.finfo(np.float32).max, np.inf]]).astype(np.float32)
    shown = compress_highlights(values)
    assert (np.diff(shown) >= 0).all()
    assert (np.diff(shown[:2000]) > 0).all()
    assert shown.max() <= 1


def test_highlights_below_the_shoulder_are_untouched_and_bad_values_black():
    values = np.array([0.0, 0.1, 0.49])
    np.testing.assert_array_equal(compress_highlights(values), values)
    np.testing.assert_array_equal(compress_highlights(np.array([-1.0, np.nan, -np.inf])), 0)


def test_highlights_bend_without_a_kink():
    step = 1e-4
    slopes = np.diff(compress_highlights(np.arange(0.4, 0.6, step))) / step
    # The second derivative is at most 2 / 0.5, so neighboring slopes differ by less than 5 steps.
    assert np.abs(np.diff(slopes)).max() < 5 * step


def test_exposure_scales_inversely_with_light_over_16_decades():
    colors = np.random.default_rng(1).lognormal(size=(10_000, 3))
    scale = exposure_scale(colors)
    for factor in (1e-8, 1e8):
        assert exposure_scale(colors * factor) == pytest.approx(scale / factor, rel=1e-9)


def test_exposure_does_not_depend_on_order_or_on_dark_and_bad_values():
    colors = np.random.default_rng(2).lognormal(size=(5000, 3))
    expected = exposure_scale(colors)
    spoiled = np.concatenate([colors, np.zeros((9, 3)), np.full((1, 3), -1), np.full((1, 3), np.nan), [[1, np.inf, 0]]])
    assert exposure_scale(np.random.default_rng(3).permutation(spoiled)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("hue", [(1, 1, 1), (1, 0, 0), (0.2, 0.1, 1)])
def test_evenly_lit_surface_of_any_color_is_shown_just_below_white(hue):
    assert exposure_scale(np.full((100, 3), 7.0) * hue) * 7 == pytest.approx(0.85)


def test_dark_room_with_a_lamp_is_brightened_by_at_most_half_a_stop():
    values = np.concatenate([np.full(9000, 0.01), np.full(1000, 10.0)])
    assert exposure_scale(np.tile(values[:, None], 3)) * 10 == pytest.approx(0.85 * 1.4)


def test_white_walls_keep_their_shading_above_a_large_dark_floor():
    walls = np.linspace(0.8, 1.0, 2000)
    colors = np.tile(np.concatenate([np.full(8000, 0.05), walls])[:, None], 3)
    shown = 255 * linear_to_srgb(compress_highlights(walls * exposure_scale(colors)))
    assert shown.max() < 235
    assert np.ptp(shown) > 6  # of 255, for a quarter more light: twice what a shoulder at 0.7 leaves


def test_exposure_of_no_light_is_one():
    assert exposure_scale(np.zeros((10, 3))) == 1
    assert exposure_scale(np.empty((0, 3))) == 1


def test_dithering_keeps_the_mean_between_two_steps():
    for value in (0.0, 1 / 255, 0.5, 100.3 / 255, 100.9 / 255, 1.0):
        shown = dither_to_bytes(np.full((200, 300, 3), value))
        # 60,000 equidistributed thresholds: the discrepancy of such a sequence is far below 1e-3.
        np.testing.assert_allclose(shown.mean(axis=(0, 1)), value * 255, atol=1e-3)
        assert int(shown.max()) - int(shown.min()) <= 1


def test_dithering_in_bands_equals_dithering_at_once():
    picture = np.random.default_rng(4).random((50, 20, 3))
    bands = [dither_to_bytes(picture[top : top + 7], top) for top in range(0, 50, 7)]
    np.testing.assert_array_equal(np.concatenate(bands), dither_to_bytes(picture))
