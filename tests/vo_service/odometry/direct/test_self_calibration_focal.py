"""The focal length is learned from frames whose intrinsics are wrong."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drivers.camera import FocalPrior, RgbdFrame, TimingPrior, TimingSource
from tests.vo_service.odometry.direct.rolling_shutter_views import add_noise, render_view
from tests.vo_service.odometry.direct.swinging_camera import SwingingCamera
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
from vo_service.types.estimate import Estimate, OnlineFocalLength

TOLD = TimingPrior(0.0, 0.001, 0.0005, TimingSource.CAMERA_FILE)


@cache
def swinging_frames() -> tuple[RgbdFrame, ...]:
    """Three seconds of a global shutter with noise, and with the right intrinsics."""
    views = (add_noise(render_view(SwingingCamera(), k / 30), k) for k in range(90))
    return tuple(replace(view, timing_prior=TOLD) for view in views)


def with_focal_error(frame: RgbdFrame, scale: float) -> RgbdFrame:
    camera = frame.camera
    return replace(frame, camera=replace(camera, fx=scale * camera.fx, fy=scale * camera.fy))


def learn(scale: float) -> tuple[SelfCalibratingOdometry, list[Estimate]]:
    odometry = SelfCalibratingOdometry(DirectOdometry())
    frames = (with_focal_error(frame, scale) for frame in swinging_frames())
    return odometry, [odometry.estimate(frame) for frame in frames]


def last_focal_length(estimates: list[Estimate]) -> OnlineFocalLength:
    focal_length = estimates[-1].focal_length
    assert focal_length is not None
    return focal_length


def test_a_wrong_focal_length_is_corrected() -> None:
    """Three seconds have few keyframes: a part of the error of 4 % is left."""
    for error in (0.96, 1.04):
        _, estimates = learn(error)
        assert all(estimate.ok for estimate in estimates)
        assert abs(last_focal_length(estimates).scale * error - 1.0) < 0.03


def test_with_right_intrinsics_nothing_changes() -> None:
    _, estimates = learn(1.0)
    plain = DirectOdometry()
    for estimate, frame in zip(estimates, swinging_frames(), strict=True):
        assert estimate.focal_length is not None
        assert (estimate.focal_length.scale, estimate.focal_length.source) == (1.0, "intrinsics")
        assert (estimate.T_world_camera == plain.estimate(frame).T_world_camera).all()


def test_the_same_frames_give_the_same_bits() -> None:
    (_, first), (_, second) = learn(0.96), learn(0.96)
    for a, b in zip(first, second, strict=True):
        assert (a.T_world_camera == b.T_world_camera).all()
        assert a.focal_length == b.focal_length


def test_keyframes_have_the_learned_focal_length() -> None:
    odometry, estimates = learn(0.96)
    scale = last_focal_length(estimates).scale
    told = with_focal_error(swinging_frames()[0], 0.96).camera
    assert scale > 1.0
    for keyframe in odometry.tracker.keyframes:
        assert np.isclose(keyframe.images.camera.fx, scale * told.fx, rtol=1e-9)


def test_another_sensor_starts_with_its_own_focal_length() -> None:
    odometry, estimates = learn(0.96)
    last = with_focal_error(swinging_frames()[-1], 0.96)
    other = replace(last, stamp_s=last.stamp_s + 1 / 30, serial="B2")
    assert last_focal_length(estimates).scale > 1.0
    assert last_focal_length([odometry.estimate(other)]).scale == 1.0


def test_what_an_earlier_run_has_learned_is_used_from_the_first_frame() -> None:
    odometry = SelfCalibratingOdometry(DirectOdometry())
    frames = [
        replace(with_focal_error(frame, 0.96), focal_prior=FocalPrior(1.04, 0.01))
        for frame in swinging_frames()
    ]
    first = odometry.estimate(frames[0]).focal_length
    assert first is not None
    assert first.scale == pytest.approx(1.04)
    assert first.sigma == 0.01
    last = last_focal_length([odometry.estimate(frame) for frame in frames[1:]])
    assert abs(last.scale * 0.96 - 1.0) < 0.015


def test_exact_frames_are_not_learned_from() -> None:
    odometry = SelfCalibratingOdometry(DirectOdometry())
    for frame in swinging_frames()[:8]:
        assert odometry.estimate(replace(frame, timing_prior=None)).focal_length is None


EXACT = TimingPrior(0.0, 0.0, 0.0, TimingSource.CAMERA_FILE)


def test_an_uncertain_focal_length_is_part_of_the_covariance() -> None:
    frames = swinging_frames()[:6]
    exact, unsure = DirectOdometry(), SelfCalibratingOdometry(DirectOdometry())
    for frame in frames:
        known = exact.estimate(replace(frame, timing_prior=None))
        estimate = unsure.estimate(replace(frame, timing_prior=EXACT))
    motion = se3_log(np.ascontiguousarray(estimate.T_reference_camera))
    assert estimate.focal_length is not None
    added, expected = estimate.covariance - known.covariance, np.outer(motion, motion)
    squared_error = float(added[0, 0] / expected[0, 0])
    # The best estimate is not in use yet, so the error is larger than its sigma.
    assert 1.0 <= squared_error / estimate.focal_length.sigma**2 < 2.0
    np.testing.assert_allclose(added, squared_error * expected, atol=1e-9)
