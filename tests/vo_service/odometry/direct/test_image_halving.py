"""Large images are halved before the odometry."""

import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import CAMERA, render_view
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
