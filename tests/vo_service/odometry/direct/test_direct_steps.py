"""Stages of the odometry for a frame."""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, add_noise, render_view
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.recording_stage_timer import RecordingStageTimer
from vo_service.odometry.direct.odometry import DirectOdometry

NEAR_M = 0.4


def views(*times_s: float) -> list[RgbdFrame]:
    return [add_noise(render_view(BRISK, time_s), k) for k, time_s in enumerate(times_s)]


def stages_of(frame: RgbdFrame, *before: RgbdFrame) -> list[str]:
    """Stages of a frame after others that all fit."""
    stages = RecordingStageTimer()
    odometry = DirectOdometry(timer=stages)
    assert all(estimate.ok for estimate in estimate_all(odometry, before))
    stages.names.clear()
    assert odometry.estimate(frame).ok
    return stages.names


def test_a_good_frame_is_aligned_only_with_the_keyframe() -> None:
    *before, frame = views(0.0, 1 / 30, 2 / 30)
    assert stages_of(frame, *before) == ["images", "align", "covariance"]


def test_after_a_gap_features_are_also_matched() -> None:
    *before, frame = views(0.0, 1 / 30, 1 / 30 + 0.1)
    assert stages_of(frame, *before) == ["images", "align", "recovery", "covariance"]


def occluded(frame: RgbdFrame, share: float) -> RgbdFrame:
    """The frame with this share of it behind a near gray plate."""
    color, depth = frame.color_bgr.copy(), frame.depth_raw.copy()
    until = round(share * frame.camera.width)
    color[:, :until], depth[:, :until] = 90, round(NEAR_M * frame.depth_factor)
    return replace(frame, color_bgr=color, depth_raw=depth)


def test_a_mostly_occluded_frame_is_rejected_though_the_rest_fits() -> None:
    odometry, (*before, frame, after) = DirectOdometry(), views(0.0, 1 / 30, 2 / 30, 3 / 30)
    held = estimate_all(odometry, before)[-1].T_world_camera
    estimate = odometry.estimate(occluded(frame, 0.7))
    assert not estimate.ok
    assert estimate.reason.endswith("% of the view is occluded")
    np.testing.assert_array_equal(estimate.T_world_camera, held)
    assert_close(odometry.estimate(after).T_world_camera, BRISK.pose_at(3 / 30), 0.0015, 0.05)
