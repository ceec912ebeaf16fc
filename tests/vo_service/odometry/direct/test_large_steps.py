"""Frames that are rare, so that the camera has moved far from one to the next."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame, TimingPrior, TimingSource
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    FLOOR,
    UNKNOWN_MOTION,
    WALL,
    MovingCamera,
    add_noise,
    make_empty_frame,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import se3_log, zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import (
    FOCAL_PRIOR_SIGMA,
    MAX_SQUARED_POSE_DIFFERENCE,
)
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.recovery import (
    FeatureSearch,
    KeyframeMatch,
    rejection_reason_after,
)
from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
from vo_service.odometry.features.extractor import SurfExtractor

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
    alignment = align(
        keyframe.points,
        build_image_pyramid(view(1)),
        match.T_camera_keyframe,
        UNKNOWN_MOTION,
        1.0,
        uniform_weights(),
    )
    right = TrackingResult(keyframe, alignment, UNKNOWN_MOTION)
    assert match.agrees(right)
    assert not match.agrees(right.with_pose(turned(0.5 * STEP_RAD), np.zeros(6)))


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


def test_a_pose_by_features_has_the_uncertain_focal_length_in_its_covariance() -> None:
    told = TimingPrior(0.0, 0.0, 0.0, TimingSource.CAMERA_FILE)
    frames = [replace(frame, timing_prior=told) for frame in (view(0), darkened(view(1)))]
    unsure = estimate_all(SelfCalibratingOdometry(DirectOdometry()), frames)[1]
    exact = estimate_all(DirectOdometry(), frames)[1]
    assert unsure.reason.startswith("features only: ")
    motion = se3_log(np.ascontiguousarray(unsure.T_reference_camera))
    added = FOCAL_PRIOR_SIGMA**2 * np.outer(motion, motion)
    np.testing.assert_allclose(unsure.covariance - exact.covariance, added, atol=1e-12)


@pytest.mark.parametrize(("interval_s", "is_followed"), [(0.07, False), (0.1, True)])
def test_features_alone_give_a_pose_only_if_frames_are_rare(
    interval_s: float, is_followed: bool
) -> None:
    """The camera has been covered for so long that depth alone is not tried either."""
    odometry, covered_s = DirectOdometry(), 0.6
    stamps_s = np.arange(2 * interval_s, covered_s, interval_s)
    covered = [replace(make_empty_frame(view(0)), stamp_s=float(t)) for t in stamps_s]
    estimate_all(odometry, [view(0, interval_s), replace(view(0), stamp_s=interval_s), *covered])
    last = replace(darkened(view(1)), stamp_s=covered[-1].stamp_s + interval_s)
    estimate = odometry.estimate(last)
    assert estimate.ok is is_followed
    assert estimate.reason.startswith("features only") is is_followed


def test_a_view_that_may_have_slid_is_believed_only_soon_or_with_features() -> None:
    """Two planes without texture leave one direction open."""
    first, second = (
        add_noise(render_view(MovingCamera(), 0.0, (WALL, FLOOR), paint=0.0), k) for k in range(2)
    )
    keyframe = make_keyframe(
        first, build_image_pyramid(first), np.eye(4), zero_motion(), ALL_STATIC
    )
    images = build_image_pyramid(second)
    alignment = align(keyframe.points, images, np.eye(4), UNKNOWN_MOTION, 1.0, uniform_weights())
    result = TrackingResult(keyframe, alignment, UNKNOWN_MOTION)
    soon, late = (
        MotionState.at_rest(np.eye(4), images.stamp_s - elapsed_s) for elapsed_s in (0.03, 0.5)
    )
    assert rejection_reason_after(result, soon, images) == ""
    assert "elsewhere along a surface" in rejection_reason_after(result, late, images)
    match = KeyframeMatch(keyframe, alignment.T_camera_keyframe, np.diag(np.full(6, 0.01**2)))
    assert rejection_reason_after(result, late, images, match) == ""
    assert rejection_reason_after(result, late, images, replace(match, covariance=None)) != ""
