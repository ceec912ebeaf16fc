"""The weight of brightness, and vignetting, are estimated and used in the alignment."""

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
from tests.vo_service.odometry.hand_held_sequence import estimate_all
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    align,
    uniform_weights,
)
from vo_service.odometry.direct.brightness import BrightnessWeight, VignettingEstimate
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, ImagePyramid, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import BRIGHTNESS_WEIGHT, MAX_VIGNETTING
from vo_service.odometry.direct.points import Points, select_points

POINTS = select_points(build_image_pyramid(add_noise(render_view(), 0)), zero_motion(), ALL_STATIC)


def with_registration_error(frame: RgbdFrame, shift_px: int) -> RgbdFrame:
    """The same frame, the upper half of its color shifted to the left, the lower to the right."""
    upper, lower = np.array_split(frame.color_bgr, 2)
    shifted = [np.roll(upper, -shift_px, axis=1), np.roll(lower, shift_px, axis=1)]
    return replace(frame, color_bgr=np.vstack(shifted))


def shared_error(points: tuple[Points, ...], frame: RgbdFrame) -> float:
    images = build_image_pyramid(frame)
    alignment = align(points, images, np.eye(4), UNKNOWN_MOTION, 1.0, uniform_weights())
    return estimate_uncertainty(points, images, alignment, UNKNOWN_MOTION, np.zeros(2)).shared_error


def weight_after(frame: RgbdFrame, views: int = 200) -> float:
    weight = BrightnessWeight()
    error = shared_error(POINTS, frame)
    for _ in range(views):
        weight = weight.update(error)
    return weight.value


def test_independent_noise_raises_the_weight_and_errors_of_whole_regions_lower_it() -> None:
    noisy = add_noise(render_view(), 1)
    assert weight_after(noisy) > 1.5 * BRIGHTNESS_WEIGHT
    assert weight_after(with_registration_error(noisy, 1)) < BRIGHTNESS_WEIGHT


def test_it_changes_gradually() -> None:
    once = weight_after(add_noise(render_view(), 1), views=1)
    assert BRIGHTNESS_WEIGHT < once < weight_after(add_noise(render_view(), 1))


def test_a_keyframe_without_texture_changes_nothing() -> None:
    points = select_points(
        build_image_pyramid(remove_color(render_view())), zero_motion(), ALL_STATIC
    )
    error = shared_error(points, render_view())
    assert BrightnessWeight().update(error) == BrightnessWeight()


def test_the_odometry_aligns_with_the_weight_of_the_views_before() -> None:
    odometry = DirectOdometry()
    hand = MovingCamera(np.array([0.05, 0.0, 0.0, 0.0, 0.02, 0.0]))
    estimate_all(odometry, [add_noise(render_view(hand, k / 30), k) for k in range(6)])
    assert odometry.last_frame is not None
    assert odometry.last_frame.images.brightness_weight != BRIGHTNESS_WEIGHT


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
        return view_through_lens(0.2, known)[2].residual_model.sigma_brightness

    assert spread(0.2) < 0.8 * spread(0.0)


def test_the_odometry_estimates_vignetting_during_tracking() -> None:
    odometry = DirectOdometry()
    for k in range(16):
        frame = through_a_lens(add_noise(render_view(TURN, k / 8), k), 0.25)
        assert odometry.estimate(frame).ok
    assert odometry.vignetting == pytest.approx(0.25, abs=0.07)
