"""The noise of depth is learned: that of a pixel, and errors that its neighbors share."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, add_noise, render_view
from tests.vo_service.odometry.direct.tracking_results import make_result
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.synthetic_views import add_depth_noise
from vo_service.odometry.direct.depth_noise import DepthNoise
from vo_service.odometry.direct.image_halving import halve
from vo_service.odometry.direct.image_pyramid import build_image_pyramid
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import DEPTH_NOISE_PER_M, MAX_NOISE_STEP_PER_M

GOOD = make_result(np.zeros(6), np.zeros(6)).alignment


def view(sigma_per_m: float, blur_px: float = 0.0, k: int = 0) -> RgbdFrame:
    """View `k` of a brisk camera, with noise of inverse depth."""
    return add_depth_noise(add_noise(render_view(BRISK, k / 30), k), sigma_per_m, blur_px, k)


@pytest.mark.parametrize("sigma_per_m", [3e-3, 1e-2])
def test_the_noise_of_a_pixel_is_measured_in_planes(sigma_per_m: float) -> None:
    noise = DepthNoise().update(build_image_pyramid(view(sigma_per_m)))
    assert noise.measured_per_m == pytest.approx(sigma_per_m, rel=0.2)
    assert noise.value_per_m == noise.measured_per_m


def test_the_noise_of_a_small_image_is_measured() -> None:
    images = build_image_pyramid(halve(halve(view(6e-3))))
    assert images.depth.raw.shape == (60, 80)
    assert DepthNoise().update(images).measured_per_m == pytest.approx(6e-3, rel=0.2)


def test_less_noise_than_a_kinect_has_is_not_used() -> None:
    noise = DepthNoise().update(build_image_pyramid(render_view()))
    assert noise.measured_per_m is not None
    assert noise.measured_per_m < DEPTH_NOISE_PER_M == noise.value_per_m


def test_errors_that_neighbors_share_are_learned() -> None:
    estimates = estimate_all(DirectOdometry(), [view(8e-3, 6.0, k) for k in range(10)])
    for k, estimate in enumerate(estimates):
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.02, 0.7)
    first, last = estimates[0].depth_noise_per_m, estimates[-1].depth_noise_per_m
    assert first is not None
    assert last is not None
    assert first < 3e-3 < last < 8e-3


def test_depth_that_fits_does_not_raise_the_noise() -> None:
    noise = DepthNoise(2e-3)
    assert noise.raised_for(GOOD) is noise


def test_the_noise_is_raised_to_what_the_depth_needs_but_not_beyond_any_sensors() -> None:
    model = GOOD.residual_model
    model = model._replace(sigma_depth=8.0 * model.depth_noise)
    misfit = replace(GOOD, residual_model=model)
    assert DepthNoise(2e-3).raised_for(misfit).value_per_m == pytest.approx(8e-3)
    large = DepthNoise(0.5 * MAX_NOISE_STEP_PER_M)
    assert large.raised_for(misfit) is large
