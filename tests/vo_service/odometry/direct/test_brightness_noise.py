"""Noise of a gray image is measured, and is no texture."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import WALL, add_noise, render_view
from vo_service.odometry.direct import points
from vo_service.odometry.direct.brightness_noise import measure_brightness_noise
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import MIN_TEXTURE_GRADIENTS, MIN_TEXTURE_SIGMAS
from vo_service.odometry.direct.points import smallest_gradient


def noisy(image: NDArray[np.uint8], sigma: float) -> NDArray[np.uint8]:
    noise = np.random.default_rng(1).normal(0.0, sigma, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 5.0])
def test_the_noise_of_a_smooth_image_is_measured(sigma: float) -> None:
    ramp = np.tile(np.linspace(60, 180, 160).astype(np.uint8), (120, 1))
    assert measure_brightness_noise(noisy(ramp, sigma)) == pytest.approx(sigma, rel=0.15)


def test_texture_in_half_of_the_image_is_no_noise() -> None:
    image = np.full((120, 160), 90, np.uint8)
    blobs = np.random.default_rng(2).integers(0, 255, (15, 40), np.uint8)
    image[60:] = cv2.resize(blobs, (160, 60), interpolation=cv2.INTER_CUBIC)
    assert measure_brightness_noise(noisy(image, 1.5)) == pytest.approx(1.5, rel=0.2)


def test_a_tiny_image_has_no_noise() -> None:
    assert measure_brightness_noise(np.zeros((7, 40), np.uint8)) == 0.0
    assert measure_brightness_noise(np.zeros((40, 9), np.uint8)) == 0.0


def test_texture_is_steeper_than_the_noise_within_limits() -> None:
    smallest, largest = MIN_TEXTURE_GRADIENTS
    between = 0.5 * (smallest + largest) / MIN_TEXTURE_SIGMAS
    gradients = [smallest_gradient(noise) for noise in (0.0, between, 100.0)]
    assert gradients == [smallest, 0.5 * (smallest + largest), largest]


def test_half_the_size_has_half_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    images, counts = build_image_pyramid(render_view(paint=0.2)), []
    for noise in (0.0, 2.0):
        monkeypatch.setattr(points, "measure_brightness_noise", lambda gray, noise=noise: noise)
        levels = points.select_points(images, zero_motion(), ALL_STATIC)
        counts.append([int(level.has_texture.sum()) for level in levels])
    assert counts[1][0] < counts[0][0]
    assert counts[1][1:] == counts[0][1:]


def in_the_dark(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, color_bgr=noisy(np.full_like(frame.color_bgr, 20), 8.0))


def test_a_bare_wall_in_the_dark_is_no_start() -> None:
    wall = in_the_dark(add_noise(render_view(planes=(WALL,)), 1))
    reason = DirectOdometry().estimate(wall).reason
    assert reason == "cannot start: degenerate view: 3 of 6 degrees of freedom are unconstrained"
