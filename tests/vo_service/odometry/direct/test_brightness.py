"""The weight of brightness follows the errors that neighboring samples share."""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import (
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
from vo_service.odometry.direct.brightness import BrightnessWeight
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import BRIGHTNESS_WEIGHT
from vo_service.odometry.direct.points import select_points

POINTS = select_points(build_image_pyramid(add_noise(render_view(), 0)), zero_motion(), ALL_STATIC)


def with_registration_error(frame: RgbdFrame, shift_px: int) -> RgbdFrame:
    """The same frame, the upper half of its color shifted to the left, the lower to the right."""
    upper, lower = np.array_split(frame.color_bgr, 2)
    shifted = [np.roll(upper, -shift_px, axis=1), np.roll(lower, shift_px, axis=1)]
    return replace(frame, color_bgr=np.vstack(shifted))


def align_frame(frame: RgbdFrame) -> DirectAlignment:
    images = build_image_pyramid(frame)
    return align(POINTS, images, np.eye(4), UNKNOWN_MOTION, 1.0, uniform_weights())


def shared_error(points: tuple[Array, ...], frame: RgbdFrame) -> float:
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
