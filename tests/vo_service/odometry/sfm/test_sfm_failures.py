"""Failures of structure from motion."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import is_rigid
from tests.vo_service.odometry.estimate_checks import assert_valid_or_explained
from tests.vo_service.odometry.hand_held_sequence import (
    BLACK,
    assert_close,
    estimate_all,
    render_elsewhere,
)
from tests.vo_service.odometry.sfm.sideways_sequence import (
    remove_depth,
    render_view,
    render_views,
    sideways_pose,
)
from tests.vo_service.odometry.surf.test_surf_odometry_failures import garbage
from vo_service.odometry.sfm.odometry import SfmOdometry
from vo_service.odometry.sfm.parameters import SfmParameters


def test_a_black_start_fails_and_the_next_good_frame_starts() -> None:
    black, first = estimate_all(SfmOdometry(), [BLACK, render_view(0)])
    assert not black.ok
    assert "too few features" in black.reason
    assert first.ok


def test_a_failed_frame_keeps_the_pose_and_is_skipped() -> None:
    odometry = SfmOdometry()
    before = estimate_all(odometry, render_views(7))[-1]
    failed, after = estimate_all(odometry, [BLACK, render_view(8)])
    assert not failed.ok
    assert failed.reason == "only 0 of 0 matches are known points"
    assert np.array_equal(failed.T_world_camera, before.T_world_camera)
    assert np.array_equal(failed.T_reference_camera, np.eye(4))
    assert after.ok
    assert_close(after.T_world_camera, sideways_pose(8), 0.03, 0.5)


def test_an_unconstrained_motion_is_rejected() -> None:
    odometry = SfmOdometry(parameters=SfmParameters(max_sigma_rad=1e-5))
    estimates = estimate_all(odometry, render_views(8))
    unsure = estimates[-1]
    assert sum(estimate.ok for estimate in estimates) == 2
    assert not unsure.ok
    assert unsure.reason.startswith("the motion is too uncertain")
    assert not unsure.covariance.any()


def test_a_step_too_long_for_a_camera_is_rejected() -> None:
    odometry = SfmOdometry()
    before = estimate_all(odometry, render_views(7))[-1]
    jump = odometry.estimate(replace(render_view(11), stamp_s=render_view(6).stamp_s + 0.01))
    assert not jump.ok
    assert jump.reason.startswith("the step is too long for a camera")
    assert np.array_equal(jump.T_world_camera, before.T_world_camera)


def test_a_frozen_image_waits_for_parallax_without_a_failure() -> None:
    odometry = SfmOdometry(parameters=SfmParameters(max_failures=1))
    first, *frozen = estimate_all(odometry, [render_view(0)] * 5)
    assert first.ok
    assert all("waiting for parallax" in e.reason for e in frozen)
    assert not any(e.is_reset for e in frozen)


def test_without_depth_there_is_no_initial_scale() -> None:
    estimates = estimate_all(SfmOdometry(), map(remove_depth, render_views(7)))
    assert estimates[0].ok
    assert not any(e.ok for e in estimates[1:])
    assert estimates[-1].reason == "no initial scale from the depth of the first frame"


def test_after_too_many_failures_tracking_and_scale_restart() -> None:
    odometry = SfmOdometry(parameters=SfmParameters(max_failures=2))
    before = estimate_all(odometry, render_views(7))[-1]
    lost = estimate_all(odometry, [BLACK, render_elsewhere(0), render_elsewhere(0)])
    assert [e.ok for e in lost] == [False, False, True]
    assert [e.is_reset for e in lost] == [False, False, True]
    assert np.array_equal(lost[2].T_world_camera, before.T_world_camera)
    waiting = odometry.estimate(replace(render_elsewhere(0), seq=1))
    assert not waiting.ok
    assert "waiting for parallax" in waiting.reason


def test_a_camera_that_turns_back_is_recovered_by_an_older_keyframe() -> None:
    odometry = SfmOdometry()
    estimate_all(odometry, render_views(9))
    estimate_all(odometry, [render_elsewhere(0)])
    found = estimate_all(odometry, [render_view(5)] * 4)[-1]
    assert found.ok
    assert not found.is_reset
    assert_close(found.T_world_camera, sideways_pose(5), 0.03, 0.5)


@settings(max_examples=15)
@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 5)), min_size=2, max_size=4))
def test_no_frame_raises_and_every_pose_is_rigid(kinds: list[tuple[int, int]]) -> None:
    odometry = SfmOdometry(parameters=SfmParameters(max_failures=1))
    for seed, kind in kinds:
        estimate = odometry.estimate(garbage(seed, kind))
        assert_valid_or_explained(estimate)


def test_random_images_after_a_good_start_fail_without_an_exception() -> None:
    odometry = SfmOdometry(parameters=SfmParameters(max_failures=3))
    estimate_all(odometry, render_views(7))
    for seed in range(8):
        estimate = odometry.estimate(garbage(seed, seed % 5))
        assert is_rigid(estimate.T_world_camera)
        assert np.all(np.isfinite(estimate.covariance))
