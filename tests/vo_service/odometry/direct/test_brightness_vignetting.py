"""Vignetting is estimated, and compensated in the alignment."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    CAMERA,
    STILL,
    UNKNOWN_MOTION,
    MovingCamera,
    add_noise,
    remove_color,
    render_view,
)
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    align,
    uniform_weights,
)
from vo_service.odometry.direct.brightness import VignettingEstimate
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, ImagePyramid, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import MAX_VIGNETTING
from vo_service.odometry.direct.residuals import (
    SIGMA_BRIGHTNESS,
)

# 9 degrees to the right and 4 down in a second.
TURN = MovingCamera(np.array([0.05, 0.0, 0.0, -0.07, 0.16, 0.02]))


def through_a_lens(frame: RgbdFrame, true_vignetting: float) -> RgbdFrame:
    """The same frame, darker towards its corners."""
    x = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    y = (np.arange(CAMERA.height) - CAMERA.cy) / CAMERA.fy
    brightness_share = 1.0 - true_vignetting * (x**2 + y[:, None] ** 2)
    return replace(
        frame, color_bgr=np.rint(frame.color_bgr * brightness_share[..., None]).astype(np.uint8)
    )


def keyframe_of(frame: RgbdFrame) -> DirectKeyframe:
    return make_keyframe(frame, build_image_pyramid(frame), np.eye(4), zero_motion(), ALL_STATIC)


def align_frame(
    keyframe: DirectKeyframe, images: ImagePyramid, hand: MovingCamera = STILL
) -> DirectAlignment:
    start = inverse(hand.pose_at(1.0))
    return align(keyframe.points, images, start, UNKNOWN_MOTION, 1.0, uniform_weights())


def view_through_lens(
    true_vignetting: float, known: float = 0.0
) -> tuple[DirectKeyframe, ImagePyramid, DirectAlignment]:
    """A keyframe, and a view after a turn, through the same lens."""
    keyframe = keyframe_of(through_a_lens(add_noise(render_view(), 0), true_vignetting))
    images = build_image_pyramid(
        through_a_lens(add_noise(render_view(TURN, 1.0), 1), true_vignetting), known
    )
    return keyframe, images, align_frame(keyframe, images, TURN)


@pytest.mark.parametrize("true_vignetting", [-0.1, 0.0, 0.2])
@pytest.mark.parametrize("known", [0.0, 0.15])
def test_one_rotation_determines_most_of_the_vignetting(
    true_vignetting: float, known: float
) -> None:
    first = VignettingEstimate(known, information=1.0)
    assert first.update(*view_through_lens(true_vignetting, known)).value == pytest.approx(
        true_vignetting, abs=0.03
    )


def test_the_estimate_is_updated_gradually() -> None:
    view = view_through_lens(0.2)
    once = VignettingEstimate().update(*view)
    twice = once.update(*view)
    assert 0.1 < once.value < twice.value < 0.21
    assert VignettingEstimate().information < once.information < twice.information


def test_a_view_at_rest_gives_no_estimate() -> None:
    keyframe = keyframe_of(through_a_lens(add_noise(render_view(), 0), 0.2))
    images = build_image_pyramid(through_a_lens(add_noise(render_view(), 1), 0.2))
    known = VignettingEstimate(0.1, information=400.0)
    after = known.update(keyframe, images, align_frame(keyframe, images))
    assert after.value == pytest.approx(0.1, abs=0.02)
    assert after.information < 1.05 * known.information


def test_darkness_gives_no_estimate() -> None:
    keyframe, images = (
        keyframe_of(remove_color(render_view())),
        build_image_pyramid(remove_color(render_view())),
    )
    assert VignettingEstimate(0.1).update(
        keyframe, images, align_frame(keyframe, images)
    ) == VignettingEstimate(0.1)


def test_the_estimate_has_a_maximum() -> None:
    keyframe, images, found = view_through_lens(0.2)
    absurd = replace(images, vignetting=9.0)
    assert VignettingEstimate().update(keyframe, absurd, found).value == MAX_VIGNETTING


def test_correction_reduces_the_residuals() -> None:
    def spread(known: float) -> float:
        return float(view_through_lens(0.2, known)[2].residual_model[SIGMA_BRIGHTNESS])

    assert spread(0.2) < 0.8 * spread(0.0)


def test_the_odometry_estimates_vignetting_during_tracking() -> None:
    odometry = DirectOdometry()
    for k in range(16):
        frame = through_a_lens(add_noise(render_view(TURN, k / 8), k), 0.25)
        assert odometry.estimate(frame).ok
    assert odometry.vignetting == pytest.approx(0.25, abs=0.07)
