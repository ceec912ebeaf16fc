"""Large images are halved before the odometry."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    keep_depth_grid,
    make_empty_frame,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.image_halving import HalvingOdometry, halve
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.types.estimate import Estimate


class SizeRecorder(DirectOdometry):
    """Records the sizes of its frames."""

    sizes: tuple[tuple[int, int], ...] = ()

    def estimate(self, frame: RgbdFrame) -> Estimate:
        self.sizes += ((frame.camera.width, frame.camera.height),)
        assert frame.color_bgr.shape[:2] == frame.depth_raw.shape == self.sizes[-1][::-1]
        return super().estimate(frame)


@pytest.mark.parametrize(
    ("size", "halved"),
    [((960, 540), (960, 540)), ((961, 540), (481, 270)), ((1080, 1921), (270, 481))],
)
def test_the_longer_side_is_at_most_960_pixels(
    size: tuple[int, int], halved: tuple[int, int]
) -> None:
    camera = PinholeCamera(*size, 500.0, 500.0, size[0] / 2, size[1] / 2)
    odometry = SizeRecorder()
    HalvingOdometry(odometry).estimate(render_view(camera=camera))
    assert odometry.sizes == (halved,)


def test_a_pixel_is_every_second_one_with_the_same_ray_and_depth() -> None:
    frame = render_view()
    small = halve(frame)
    np.testing.assert_array_equal(small.depth_raw, frame.depth_raw[::2, ::2])
    ray = (np.arange(0, CAMERA.width, 2) - CAMERA.cx) / CAMERA.fx
    u = np.arange(small.camera.width)
    np.testing.assert_allclose((u - small.camera.cx) / small.camera.fx, ray, atol=1e-12)
    inside = np.s_[2:-2, 2:-2]
    changed = small.gray[inside].astype(float) - frame.gray[::2, ::2][inside]
    assert abs(changed.mean()) < 0.1
    assert changed.std() < small.gray.std() / 3


@pytest.mark.parametrize("pitch_px", [3.0, 4.6])
def test_a_sparse_grid_of_depth_is_followed(pitch_px: float) -> None:
    frames = [keep_depth_grid(frame, pitch_px) for frame in render_sequence(BRISK, 6)]
    for frame, estimate in zip(
        frames, estimate_all(HalvingOdometry(DirectOdometry()), frames), strict=True
    ):
        assert_close(estimate.T_world_camera, BRISK.pose_at(frame.stamp_s), 0.004, 0.15)


def test_the_size_is_chosen_once_the_first_frame_is_tracked() -> None:
    odometry = SizeRecorder()
    first, second = render_sequence(BRISK, 2)
    halving = HalvingOdometry(odometry)
    for frame in (make_empty_frame(first), keep_depth_grid(first, 3.0), second):
        halving.estimate(frame)
    assert odometry.sizes == ((320, 240), (160, 120), (160, 120))


def test_another_sensor_has_its_own_size() -> None:
    odometry = SizeRecorder()
    halving = HalvingOdometry(odometry)
    halving.estimate(keep_depth_grid(render_view(), 3.0))
    halving.estimate(replace(render_view(), serial="other"))
    assert odometry.sizes == ((160, 120), (320, 240))


def test_missing_depth_is_that_of_the_nearest_surface_around_it() -> None:
    frame = replace(render_view(), depth_raw=np.zeros((240, 320), np.uint16))
    frame.depth_raw[9:12, 9:12] = [[1000, 0, 1020], [0, 0, 0], [0, 0, 3000]]
    halved = halve(frame).depth_raw
    assert halved[5, 5] == 1010
    assert halved[3, 5] == halved[5, 3] == 0
