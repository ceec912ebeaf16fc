from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.odometry.keyframe.rolling_views import CAMERA, STILL, film, lit, seen
from vo_service.odometry.keyframe.images import Shutter, at_level, make_images


def test_each_grey_image_is_half_the_size_of_the_one_before() -> None:
    images = make_images(seen())
    assert [grey.shape for grey in images.grey] == [(120, 160), (60, 80), (30, 40), (15, 20)]
    assert images.inverse_depth.shape == (240, 320)


def test_a_pixel_of_a_smaller_image_is_the_mean_of_four() -> None:
    frame = seen()
    mean = frame.grey.reshape(120, 2, 160, 2).mean(axis=(1, 3))
    assert np.abs(make_images(frame).grey[0] - mean).max() <= 0.5


def test_a_place_has_the_same_ray_in_every_size() -> None:
    whole = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    fx, fy, cx, cy = at_level(whole, 2)
    # The first pixel of a quarter covers the first four, whose middle is 1.5.
    assert (0.0 - cx) / fx == pytest.approx((1.5 - CAMERA.cx) / CAMERA.fx)
    assert (0.0 - cy) / fy == pytest.approx((1.5 - CAMERA.cy) / CAMERA.fy)
    intrinsics = make_images(seen()).intrinsics
    np.testing.assert_array_equal(intrinsics[0], whole)
    np.testing.assert_array_equal(intrinsics[2], [fx, fy, cx, cy])


def test_inverse_depth_is_zero_where_there_is_no_reading() -> None:
    frame = seen()
    depth_raw = frame.depth_raw.copy()
    depth_raw[10:20] = 0
    inverse_depth = make_images(replace(frame, depth_raw=depth_raw)).inverse_depth
    assert not inverse_depth[10:20].any()
    np.testing.assert_allclose(inverse_depth[30:] * frame.depth_m[30:], 1.0, rtol=1e-6)


def test_images_whose_size_is_odd_lose_their_last_line() -> None:
    frame = seen()
    odd = replace(frame, colour_bgr=frame.colour_bgr[:-1, :-1], depth_raw=frame.depth_raw[:-1, :-1])
    images = make_images(odd)
    assert images.grey[0].shape == (119, 159)
    np.testing.assert_array_equal(images.grey[0], make_images(frame).grey[0][:-1, :-1])


def test_a_shutter_is_instant_only_if_both_images_are_of_one_instant() -> None:
    assert make_images(seen()).shutter.is_instant
    assert not Shutter(0.02, 0.0).is_instant
    assert not Shutter(0.0, -0.01).is_instant


def test_light_is_compared_within_what_is_believed_of_it() -> None:
    frame, brighter = film(STILL, 2)
    bright = make_images(lit(brighter, 1.4))
    assert bright.light_against(make_images(frame)) == pytest.approx(1.4, rel=0.03)
    black = make_images(lit(frame, 0.0))
    assert black.light_against(bright) * bright.light_against(black) == pytest.approx(1.0)
    assert 0.1 < black.light_against(bright) < 1.0
