"""Frames that are rare, so that the camera has moved far from one to the next."""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    MovingCamera,
    add_noise,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct import DirectOdometry
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import se3_log, zero_motion
from vo_service.odometry.direct.parameters import MAX_SQUARED_POSE_DIFFERENCE
from vo_service.odometry.direct.recovery import FeatureSearch
from vo_service.odometry.surf import SurfExtractor

INTERVAL_S = 0.6
STEP_RAD = 0.12


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), np.zeros(3))


def view(k: int, interval_s: float = INTERVAL_S) -> RgbdFrame:
    """Frame k of a camera that turns by the same angle from frame to frame."""
    frame = render_view(MovingCamera(T_world_start=turned(STEP_RAD * k)), 0.0)
    return replace(add_noise(frame, k), stamp_s=k * interval_s)


def darkened(frame: RgbdFrame) -> RgbdFrame:
    """The frame with too little light for an alignment of brightness."""
    return replace(frame, color_bgr=(0.35 * frame.color_bgr).astype(np.uint8))


def test_a_constant_turn_is_followed_over_large_steps() -> None:
    for k, estimate in enumerate(estimate_all(DirectOdometry(), [view(k) for k in range(5)])):
        assert estimate.ok
        assert_close(estimate.T_world_camera, turned(STEP_RAD * k), 0.004, 0.1)


def test_features_agree_with_the_right_pose_only() -> None:
    images = build_image_pyramid(view(0))
    keyframe = make_keyframe(view(0), images, np.eye(4), zero_motion(), ALL_STATIC)
    (match,) = FeatureSearch(SurfExtractor()).find_matches(view(1), [keyframe])
    assert match.covariance is not None
    assert_close(match.T_world_camera, turned(STEP_RAD), 0.02, 0.5)
    sigma = np.sqrt(np.diag(match.covariance))
    assert np.all(sigma > 0.0)
    assert np.all(sigma < 0.05)


def test_a_rare_frame_without_an_alignment_takes_the_pose_by_features() -> None:
    frames = [view(0), darkened(view(1)), darkened(view(2))]
    _, dark, next_dark = estimate_all(DirectOdometry(), frames)
    assert dark.reason.startswith("features only: ")
    assert dark.is_next_reference
    error = se3_log(np.ascontiguousarray(inverse(dark.T_world_camera) @ turned(STEP_RAD)))
    assert error @ np.linalg.solve(dark.covariance, error) < MAX_SQUARED_POSE_DIFFERENCE
    # It is a keyframe, which the next frame is aligned with.
    assert next_dark.ok
    assert_close(next_dark.T_world_camera, turned(2 * STEP_RAD), 0.02, 0.6)


def test_between_frames_that_are_close_features_alone_give_no_pose() -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, [view(0, 1 / 30)])
    assert not odometry.estimate(darkened(view(1, 1 / 30))).reason.startswith("features only")
