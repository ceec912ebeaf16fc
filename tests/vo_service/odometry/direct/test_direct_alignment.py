"""A frame aligned with a keyframe: motion, velocity and light are found."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, is_rigid, so3_log
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    SHAKING,
    STILL,
    MovingCamera,
    add_noise,
    change_lighting,
    remove_color,
    remove_depth,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close
from vo_service.odometry.direct.alignment import (
    STATIC_PRIOR,
    DirectAlignment,
    align,
    depth_only_weights,
    uniform_weights,
)
from vo_service.odometry.direct.gauss_newton import MotionPrior, velocity_information
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import ACCELERATION_START, change_frame, zero_motion
from vo_service.odometry.direct.points import select_points
from vo_service.odometry.direct.quality import degradation_reason, rejection_reason

POINTS = select_points(build_image_pyramid(render_view()), zero_motion(), ALL_STATIC)
# An unknown velocity.
LOOSE = STATIC_PRIOR._replace(information=np.full(9, 1e-3))


def align_frame(
    frame: RgbdFrame,
    prior: MotionPrior = LOOSE,
    weights: Array | None = None,
) -> DirectAlignment:
    weights = uniform_weights() if weights is None else weights
    return align(POINTS, build_image_pyramid(frame), np.eye(4), prior, 1.0, weights)


@pytest.mark.parametrize("time_s", [0.0, 0.03, 0.12, -0.12])
def test_a_known_motion_is_estimated_to_a_fraction_of_a_millimeter(time_s: float) -> None:
    found = align_frame(render_view(BRISK, time_s))
    assert is_rigid(found.T_camera_keyframe, 1e-9)
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(time_s), 0.0005, 0.01)
    assert rejection_reason(found) == degradation_reason(found) == ""


@pytest.mark.parametrize("seed", range(3))
def test_noise_changes_the_motion_little(seed: int) -> None:
    found = align_frame(add_noise(render_view(BRISK, 0.1), seed))
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.001, 0.03)


@pytest.mark.parametrize("gain", [0.7, 1.2])
def test_the_gain_of_the_brightness_is_estimated(gain: float) -> None:
    found = align_frame(change_lighting(render_view(BRISK, 0.05), gain))
    assert found.gain == pytest.approx(gain, abs=0.05)
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.05), 0.0007, 0.02)


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.02, 0.01), (0.03, 0.0), (0.02, -0.012)])
def test_motion_and_velocity_of_a_rolling_shutter_view_are_estimated(
    readout_s: float, skew_s: float
) -> None:
    found = align_frame(render_view(BRISK, 0.1, readout_s=readout_s, skew_s=skew_s))
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.0015, 0.05)
    np.testing.assert_allclose(found.camera_velocity, BRISK.velocity, atol=0.06)


@pytest.mark.parametrize("skew_s", [-0.012, 0.0, 0.012])
def test_an_angular_acceleration_during_the_readout_is_estimated(skew_s: float) -> None:
    frame = render_view(SHAKING, readout_s=0.02, skew_s=skew_s)
    filter_pose = LOOSE.information.copy()
    filter_pose[ACCELERATION_START:] = 1e6
    found, held = align_frame(frame), align_frame(frame, LOOSE._replace(information=filter_pose))
    acceleration_rad_s2_found = found.camera_motion[ACCELERATION_START:]
    np.testing.assert_allclose(acceleration_rad_s2_found, SHAKING.acceleration_rad_s2, atol=3.0)
    assert not np.abs(held.camera_motion[ACCELERATION_START:]).max() > 1.0
    assert off_rad(found) < 3e-4
    assert skew_s == 0.0 or off_rad(found) < 0.4 * off_rad(held)


def off_rad(found: DirectAlignment) -> float:
    """Rotation of the estimated motion, which should be zero."""
    return float(np.linalg.norm(so3_log(found.T_camera_keyframe[:3, :3])))


def test_late_depth_gives_no_velocity_but_the_motion_of_the_color() -> None:
    late = render_view(BRISK, 0.1, skew_s=0.012)
    with_skew, without_skew = (
        align_frame(late, moving()),
        align_frame(replace(late, skew_s=0.0), moving()),
    )
    error_m, error_without_skew_m = (
        np.linalg.norm((inverse(each.T_camera_keyframe) - BRISK.pose_at(0.1))[:3, 3])
        for each in (with_skew, without_skew)
    )
    assert error_m < 0.0005
    assert error_without_skew_m > 3 * error_m


def moving() -> MotionPrior:
    """A prior with the velocity known as from frame to frame."""
    last = BRISK.pose_at(0.1 - 1 / 30)
    return MotionPrior(
        last, 30.0, -change_frame(BRISK.motion, last), velocity_information(np.array([0.03, 0.1]))
    )


def test_a_global_shutter_is_a_readout_of_zero() -> None:
    """With very short times the result is nearly that of an instant shutter."""
    frame = add_noise(render_view(BRISK, 0.1), 1)
    instant = align_frame(frame, moving())
    nearly = align_frame(replace(frame, readout_s=1e-9, skew_s=1e-9), moving())
    np.testing.assert_allclose(nearly.T_camera_keyframe, instant.T_camera_keyframe, atol=1e-6)
    np.testing.assert_allclose(nearly.motion, instant.motion, atol=1e-4)


def test_depth_alone_suffices_in_a_corner() -> None:
    for frame, weights in (
        (remove_color(render_view(BRISK, 0.1)), depth_only_weights()),
        (render_view(BRISK, 0.1), depth_only_weights()),
    ):
        found = align_frame(frame, weights=weights)
        assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.001, 0.03)
        assert not found.uses_brightness
        assert degradation_reason(found).startswith("depth only")


def test_brightness_alone_suffices_with_texture() -> None:
    found = align_frame(remove_depth(render_view(BRISK, 0.1)))
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.004, 0.1)
    assert degradation_reason(found).startswith("brightness only")


def test_a_frame_of_another_place_is_rejected() -> None:
    away = MovingCamera(np.array([0.0, 0.0, 0.0, 0.3, 1.5, 0.0]))
    assert rejection_reason(align_frame(render_view(away, 0.6))) != ""


def test_an_empty_frame_is_rejected() -> None:
    nothing = align_frame(
        remove_depth(remove_color(render_view(STILL))), weights=depth_only_weights()
    )
    assert rejection_reason(nothing) == "only 0 samples in view"


def test_a_keyframe_with_fewer_levels_is_aligned_with_a_larger_image() -> None:
    images = build_image_pyramid(render_view(BRISK, 0.02))
    found = align(POINTS[:2], images, np.eye(4), LOOSE, 1.0, uniform_weights())
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.02), 0.001, 0.03)
