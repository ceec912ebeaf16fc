"""Readout and delay are learned from frames that do not tell them."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import RgbdFrame, TimingPrior, TimingSource
from drivers.core.geometry import inverse
from drivers.registry import open_camera
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    add_noise,
    remove_color,
    remove_depth,
    render_view,
)
from tests.vo_service.odometry.direct.swinging_camera import (
    DELAY_S,
    READOUT_S,
    UNKNOWN,
    SwingingCamera,
    swinging_frames,
)
from vo_service.odometry.direct.calibration_search import TimingHypothesis
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.self_calibration import SelfCalibratingOdometry
from vo_service.odometry.registry import make_odometry
from vo_service.types.estimate import Estimate, OnlineTiming


def learn(frames: tuple[RgbdFrame, ...]) -> list[Estimate]:
    odometry = SelfCalibratingOdometry(DirectOdometry())
    return [odometry.estimate(frame) for frame in frames]


def last_timing(estimates: list[Estimate]) -> OnlineTiming:
    timing = estimates[-1].timing
    assert timing is not None
    return timing


def test_a_search_in_a_degenerate_view_makes_no_view_a_well_constrained_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else the next frames would be extrapolated with a velocity that nothing constrains."""
    states: list[MotionState] = []
    monkeypatch.setattr(TimingHypothesis, "is_well_constrained", False)
    monkeypatch.setattr(DirectOdometry, "well_constrained_stamp_s", -1.0)
    monkeypatch.setattr(
        DirectOdometry,
        "continue_from",
        lambda self, keyframes, active, *state: states.extend(state),
    )
    learn(swinging_frames(READOUT_S, DELAY_S)[:10])
    assert states[0].well_constrained_stamp_s == -1.0
    assert states[0].stamp_s > 0.0


def position_error_m(estimates: list[Estimate]) -> float:
    """Largest error of the second half of the frames, relative to its first frame."""
    half = len(estimates) // 2
    stamps_s = np.arange(half, len(estimates)) / 30
    true = SwingingCamera().poses_at(stamps_s)
    ours = np.stack([estimate.T_world_camera for estimate in estimates[half:]])
    moved = np.linalg.inv(true[0]) @ true, np.linalg.inv(ours[0]) @ ours
    return float(np.abs(moved[0][:, :3, 3] - moved[1][:, :3, 3]).max())


def test_readout_and_delay_are_learned_within_two_seconds() -> None:
    estimates = learn(swinging_frames(READOUT_S, DELAY_S))
    timing = last_timing(estimates)
    assert all(estimate.ok for estimate in estimates)
    assert abs(timing.readout_s - READOUT_S) < 0.002
    assert abs(timing.depth_offset_s - DELAY_S) < 0.0015
    assert timing.source == "learned"


def test_poses_are_within_three_sigmas_while_the_timing_is_not_known() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)[:12]
    true = SwingingCamera().poses_at(np.arange(len(frames)) / 30)
    for estimate, T_world_camera in zip(learn(frames)[1:], true[1:], strict=True):
        error = inverse(estimate.T_world_camera) @ inverse(true[0]) @ T_world_camera
        sigma_m = np.sqrt(np.linalg.eigvalsh(estimate.covariance[:3, :3])[-1])
        assert np.linalg.norm(error[:3, 3]) < 3.0 * sigma_m


def test_the_frame_that_completes_the_search_has_the_pose_that_tracking_continues_from() -> None:
    odometry = SelfCalibratingOdometry(DirectOdometry())
    for frame in swinging_frames(READOUT_S, DELAY_S)[:8]:
        estimate = odometry.estimate(frame)
        np.testing.assert_array_equal(estimate.T_world_camera, odometry.tracker.T_world_camera)


def test_the_correction_of_that_pose_is_in_its_covariance() -> None:
    """Until then the poses are those of a camera without rolling shutter."""
    frames = swinging_frames(READOUT_S, DELAY_S)[:8]
    plain = DirectOdometry()
    for estimate, frame in zip(learn(frames), frames, strict=True):
        uncorrected = plain.estimate(frame)
        if not np.array_equal(estimate.T_world_camera, uncorrected.T_world_camera):
            break
    assert estimate.is_next_reference
    step = se3_log(inverse(uncorrected.T_world_camera) @ estimate.T_world_camera)
    added = estimate.covariance - uncorrected.covariance - np.outer(step, step)
    assert np.linalg.norm(step[:3]) > 0.003
    assert np.linalg.eigvalsh(added).min() > -1e-9


def test_a_start_without_texture_is_followed_by_a_search_with_it() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)
    found = [
        estimate.timing is not None and estimate.timing.readout_s > 0.5 * READOUT_S
        for estimate in learn((*map(remove_color, frames[:24]), *frames[24:40]))
    ]
    assert not any(found[:24])
    assert found[-1]


def test_another_sensor_starts_with_its_own_prior() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)
    other = replace(frames[-1], stamp_s=frames[-1].stamp_s + 1 / 30, serial="B2")
    estimates = learn((*frames, other))
    assert [last_timing(estimates[:-1]).source, last_timing(estimates).source] == [
        "learned",
        "unknown",
    ]
    assert last_timing(estimates).readout_sigma_s == UNKNOWN.readout_sigma_s


def test_learned_timing_makes_the_poses_more_accurate() -> None:
    frames = swinging_frames(READOUT_S, DELAY_S)
    fixed = make_odometry("direct", timing="fixed")
    assert position_error_m(learn(frames)) < 0.5 * position_error_m(
        [fixed.estimate(frame) for frame in frames]
    )


def test_a_global_shutter_stays_at_exactly_zero() -> None:
    timing = last_timing(learn(swinging_frames(0.0, 0.0)))
    assert (timing.readout_s, timing.depth_offset_s) == (0.0, 0.0)


def test_a_global_shutter_stays_at_exactly_zero_with_depth_that_is_registered_off() -> None:
    frames = swinging_frames(0.0, 0.0)
    shifted = tuple(replace(f, depth_raw=np.roll(f.depth_raw, (2, 2), (0, 1))) for f in frames)
    timings = [estimate.timing for estimate in learn(shifted)]
    assert all(t is not None and (t.readout_s, t.depth_offset_s) == (0.0, 0.0) for t in timings)


def test_the_same_frames_give_the_same_bits() -> None:
    first, second = (learn(swinging_frames(READOUT_S, DELAY_S)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert (a.T_world_camera == b.T_world_camera).all()
        assert a.timing == b.timing


def test_a_camera_at_rest_learns_nothing() -> None:
    still = [add_noise(render_view(stamp_s=k / 30), k) for k in range(12)]
    timing = last_timing(learn(tuple(replace(frame, timing_prior=UNKNOWN) for frame in still)))
    assert timing == OnlineTiming(0.0, 0.0, 0.03, 0.01, "unknown")


def test_a_covered_camera_at_rest_learns_nothing() -> None:
    still = [add_noise(render_view(stamp_s=k / 30), k) for k in range(6)]
    covered = [remove_depth(remove_color(replace(still[0], stamp_s=k / 30))) for k in (6, 7)]
    frames = tuple(replace(frame, timing_prior=UNKNOWN) for frame in (*still, *covered))
    estimates = learn(frames)
    assert not estimates[-1].ok
    timing = last_timing(estimates)
    assert (timing.readout_s, timing.depth_offset_s) == (0.0, 0.0)


def test_a_right_timing_that_was_told_is_not_contradicted() -> None:
    told = TimingPrior(DELAY_S, 0.0005, 0.0005, TimingSource.CAMERA_FILE)
    timing = last_timing(
        learn(
            tuple(
                replace(f, readout_s=READOUT_S, skew_s=DELAY_S, timing_prior=told)
                for f in swinging_frames(READOUT_S, DELAY_S)
            )
        )
    )
    assert timing.contradiction is None
    assert timing.warning == ""


def test_exact_timing_is_not_estimated() -> None:
    frames = swinging_frames(0.0, 0.0)[:8]
    odometry, plain = SelfCalibratingOdometry(DirectOdometry()), DirectOdometry()
    for frame in frames:
        exact = replace(frame, timing_prior=None)
        estimate = odometry.estimate(exact)
        assert estimate.timing is None
        assert (estimate.T_world_camera == plain.estimate(exact).T_world_camera).all()


def test_fixed_timing_is_that_of_the_frames() -> None:
    odometry, plain = make_odometry("direct", timing="fixed"), DirectOdometry()
    for frame in swinging_frames(READOUT_S, DELAY_S)[:8]:
        estimate = odometry.estimate(replace(frame, timing_prior=UNKNOWN))
        assert estimate.timing is None
        assert (estimate.T_world_camera == plain.estimate(frame).T_world_camera).all()


def learn_from_a_wrong_value() -> tuple[
    SelfCalibratingOdometry, list[Estimate], dict[float, set[float]]
]:
    """Learn from frames that tell half of the readout; the readouts of each active keyframe."""
    prior = TimingPrior(0.0, 0.0049, 0.0029, TimingSource.SENSOR)
    odometry, estimates = SelfCalibratingOdometry(DirectOdometry()), []
    readouts_s: dict[float, set[float]] = {}
    for frame in swinging_frames(READOUT_S, DELAY_S):
        told = replace(frame, readout_s=0.5 * READOUT_S, timing_prior=prior)
        estimates.append(odometry.estimate(told))
        active = odometry.tracker.active_keyframe
        assert active is not None
        readouts_s.setdefault(active.images.stamp_s, set()).add(active.images.shutter.readout_s)
    return odometry, estimates, readouts_s


def test_the_active_keyframe_is_corrected_by_the_timing_in_use() -> None:
    odometry, estimates, readouts_s = learn_from_a_wrong_value()
    active, timing = odometry.tracker.active_keyframe, last_timing(estimates)
    assert active is not None
    assert any(len(each) > 1 for each in readouts_s.values())
    assert abs(active.images.shutter.readout_s - timing.readout_s) < 0.002


def test_all_keyframes_have_the_timing_in_use() -> None:
    odometry, estimates, _ = learn_from_a_wrong_value()
    timing = last_timing(estimates)
    for keyframe in odometry.tracker.keyframes:
        assert abs(keyframe.images.shutter.readout_s - timing.readout_s) < 1e-9
        assert abs(keyframe.images.shutter.skew_s - timing.depth_offset_s) < 1e-9


def test_the_motion_relative_to_the_reference_is_continuous_over_the_search() -> None:
    T_world_reference = np.eye(4)
    for estimate in learn(swinging_frames(READOUT_S, DELAY_S)):
        assert not estimate.is_reset
        moved = T_world_reference @ estimate.T_reference_camera
        np.testing.assert_allclose(moved, estimate.T_world_camera, atol=1e-9)
        if estimate.is_next_reference:
            T_world_reference = estimate.T_world_camera


def test_the_search_is_repeated_after_a_failure(recordings: Path) -> None:
    """From this frame on, the first search finds 2 ms of readout and -6 ms of delay."""
    odometry = SelfCalibratingOdometry(DirectOdometry())
    with open_camera(f"tum:{recordings / 'room_rolling'}") as camera:
        frames = islice(camera, 7, 67)
        estimates = [
            odometry.estimate(replace(frame, readout_s=0.0, skew_s=0.0, timing_prior=UNKNOWN))
            for frame in frames
        ]
    assert not all(estimate.ok for estimate in estimates)
    assert all(estimate.ok for estimate in estimates[30:])
    timing = last_timing(estimates)
    assert abs(timing.readout_s - 0.02) < 0.006
