from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.odometry.direct.rolling_shutter_views import (
    CAMERA,
    STILL,
    change_lighting,
    render_sequence,
    render_view,
)
from vo_service.odometry.direct.image_pyramid import (
    ImageTiming,
    build_image_pyramid,
)


def test_each_gray_image_is_half_the_size_of_the_one_before() -> None:
    images = build_image_pyramid(render_view())
    assert [gray.shape for gray in images.gray] == [(120, 160), (60, 80), (30, 40), (15, 20)]
    assert images.depth.inverse.shape == (240, 320)


def test_a_pixel_of_a_smaller_image_is_the_mean_of_four() -> None:
    frame = render_view()
    mean = frame.gray.reshape(120, 2, 160, 2).mean(axis=(1, 3))
    assert np.abs(build_image_pyramid(frame).gray[0] - mean).max() <= 0.5


def test_a_pixel_has_the_same_ray_at_every_level() -> None:
    whole = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    intrinsics = build_image_pyramid(render_view()).intrinsics
    fx, fy, cx, cy = intrinsics[2]
    # The first pixel of a quarter covers the first four, whose middle is 1.5.
    assert (0.0 - cx) / fx == pytest.approx((1.5 - CAMERA.cx) / CAMERA.fx)
    assert (0.0 - cy) / fy == pytest.approx((1.5 - CAMERA.cy) / CAMERA.fy)
    np.testing.assert_array_equal(intrinsics[0], whole)


def test_inverse_depth_is_zero_without_a_reading() -> None:
    frame = render_view()
    depth_raw = frame.depth_raw.copy()
    depth_raw[10:20] = 0
    inverse_depth = build_image_pyramid(replace(frame, depth_raw=depth_raw)).depth.inverse
    assert not inverse_depth[10:20].any()
    np.testing.assert_allclose(inverse_depth[30:] * frame.depth_m[30:], 1.0, rtol=1e-6)


def test_images_of_odd_size_lose_their_last_row_and_column() -> None:
    frame = render_view()
    odd = replace(frame, color_bgr=frame.color_bgr[:-1, :-1], depth_raw=frame.depth_raw[:-1, :-1])
    images = build_image_pyramid(odd)
    assert images.gray[0].shape == (119, 159)
    np.testing.assert_array_equal(images.gray[0], build_image_pyramid(frame).gray[0][:-1, :-1])


def test_a_shutter_is_global_only_if_both_images_have_one_time() -> None:
    assert build_image_pyramid(render_view()).shutter.is_instant
    assert not ImageTiming(0.02, 0.0).is_instant
    assert not ImageTiming(0.0, -0.01).is_instant


def test_brightness_is_compared_only_within_its_valid_range() -> None:
    frame, brighter = render_sequence(STILL, 2)
    bright = build_image_pyramid(change_lighting(brighter, 1.4))
    assert bright.brightness_ratio(build_image_pyramid(frame)) == pytest.approx(1.4, rel=0.03)
    black = build_image_pyramid(change_lighting(frame, 0.0))
    assert black.brightness_ratio(bright) * bright.brightness_ratio(black) == pytest.approx(1.0)
    assert 0.1 < black.brightness_ratio(bright) < 1.0
