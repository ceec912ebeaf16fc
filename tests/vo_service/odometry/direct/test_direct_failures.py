"""Frames with little or no information give a valid estimate, never an error."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    MovingCamera,
    add_noise,
    change_lighting,
    make_empty_frame,
    make_noise_frame,
    remove_color,
    remove_depth,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.estimate_checks import assert_valid
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import MAX_FAILURES, MAX_LOST_S

SHAPE = (CAMERA.height, CAMERA.width)
# Brightness noise, gray levels: strong, but the view is still recognizable.
GRAIN = 90.0


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [add_noise(frame, k) for k, frame in enumerate(render_sequence(BRISK, 6))]


Spoil = Callable[[RgbdFrame], RgbdFrame]


@pytest.mark.parametrize("spoil", [make_empty_frame, make_noise_frame])
def test_a_failed_frame_keeps_the_pose_and_is_skipped(views: list[RgbdFrame], spoil: Spoil) -> None:
    odometry = DirectOdometry()
    before = estimate_all(odometry, views[:3])[-1]
    failed = odometry.estimate(spoil(views[3]))
    assert_valid(failed)
    assert not failed.ok
    assert not failed.is_reset
    np.testing.assert_array_equal(failed.T_world_camera, before.T_world_camera)
    np.testing.assert_array_equal(failed.T_reference_camera, np.eye(4))
    after = odometry.estimate(views[4])
    assert after.ok
    assert_close(after.T_world_camera, BRISK.pose_at(4 / 30), 0.0015, 0.05)
    assert_close(after.T_reference_camera, BRISK.pose_at(4 / 30), 0.0015, 0.05)


@pytest.mark.parametrize(
    ("spoil", "reason", "error_m"),
    [
        (remove_color, "depth only: ", 0.002),
        (remove_depth, "brightness only: no depth in view", 0.006),
        (lambda frame: change_lighting(frame, 1.8), "", 0.002),
        (lambda frame: change_lighting(frame, 0.6), "", 0.002),
    ],
)
def test_half_of_the_view_suffices_and_is_reported(
    views: list[RgbdFrame], spoil: Spoil, reason: str, error_m: float
) -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, views[:2])
    for k in (2, 3, 4):
        estimate = odometry.estimate(spoil(views[k]))
        assert_valid(estimate)
        assert estimate.ok
        assert estimate.reason.startswith(reason)
        assert bool(estimate.reason) == bool(reason)
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), error_m, 0.1)
    back = odometry.estimate(views[5])
    assert back.ok
    assert back.reason == ""


def test_without_texture_the_shape_suffices() -> None:
    frames = [add_noise(render_view(BRISK, k / 30, paint=0.0), k) for k in range(4)]
    first, *others = estimate_all(DirectOdometry(), frames)
    assert first.ok
    for k, estimate in enumerate(others, 1):
        assert estimate.ok
        assert estimate.reason == "depth only: no texture in view"
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.004, 0.1)


def test_depth_alone_is_rejected_when_the_prediction_is_too_old(
    views: list[RgbdFrame],
) -> None:
    for later_s, is_believed in ((1 / 30, True), (3.0, False)):
        odometry = DirectOdometry()
        estimate_all(odometry, views)
        late = replace(remove_color(views[-1]), stamp_s=views[-1].stamp_s + later_s)
        assert odometry.estimate(late).ok is is_believed


@pytest.mark.parametrize(("later_s", "is_believed"), [(0.0, True), (1.0, False)])
def test_a_bad_fit_is_rejected_when_the_prediction_is_too_old(
    views: list[RgbdFrame], later_s: float, is_believed: bool
) -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, views[:3])
    grain = np.random.default_rng(0).normal(0.0, GRAIN, (*SHAPE, 1))
    color_bgr = np.clip(views[3].color_bgr + grain, 0, 255).astype(np.uint8)
    late = replace(views[3], stamp_s=views[3].stamp_s + later_s, color_bgr=color_bgr)
    estimate = odometry.estimate(late)
    assert estimate.ok is is_believed
    assert ("may be elsewhere" in estimate.reason) is not is_believed


def test_a_start_in_darkness_continues_in_light(views: list[RgbdFrame]) -> None:
    odometry = DirectOdometry()
    for k, frame in enumerate([remove_color(views[0]), remove_color(views[1]), *views[2:]]):
        estimate = odometry.estimate(frame)
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.003, 0.1)
    assert estimate.reason == ""


def test_a_first_keyframe_needs_more_points_than_a_frame(views: list[RgbdFrame]) -> None:
    """Depth in the center only: 169 points, where 100 are enough for a frame."""
    depth_raw = np.zeros_like(views[0].depth_raw)
    middle = np.s_[SHAPE[0] // 2 - 28 : SHAPE[0] // 2 + 28, SHAPE[1] // 2 - 28 : SHAPE[1] // 2 + 28]
    depth_raw[middle] = views[0].depth_raw[middle]
    estimate = DirectOdometry().estimate(replace(views[0], depth_raw=depth_raw))
    points = re.fullmatch(r"cannot start: only (\d+) points with depth", estimate.reason)
    assert points
    assert 100 < int(points[1]) < 200


@pytest.mark.parametrize("spoil", [make_empty_frame, make_noise_frame, remove_depth])
def test_a_start_without_points_fails_and_the_next_good_frame_starts(
    views: list[RgbdFrame], spoil: Spoil
) -> None:
    odometry = DirectOdometry()
    failed = odometry.estimate(spoil(views[0]))
    assert_valid(failed)
    assert not failed.ok
    assert failed.reason.startswith("cannot start: ")
    first, second = estimate_all(odometry, views[1:3])
    assert first.ok
    np.testing.assert_array_equal(first.T_world_camera, np.eye(4))
    assert_close(
        second.T_world_camera, inverse(BRISK.pose_at(1 / 30)) @ BRISK.pose_at(2 / 30), 0.001, 0.03
    )


def elsewhere(k: int) -> RgbdFrame:
    """A view of an unknown room."""
    corner = (((0.3, 0.0, 1.0), 1.6), ((0.0, -1.0, 0.2), 0.6), ((-1.0, 0.1, 0.3), 0.9))
    start = rigid_transform(so3_exp([0.0, 0.1, 0.4]), np.zeros(3))
    return add_noise(render_view(MovingCamera(BRISK.velocity, start), k / 30, corner), k)


def test_after_a_long_time_without_a_pose_tracking_restarts(views: list[RgbdFrame]) -> None:
    odometry = DirectOdometry()
    before = estimate_all(odometry, views[:2])[-1]
    stamps_s = np.arange(2 / 30, 1 / 30 + MAX_LOST_S, 0.2)
    black = [replace(make_empty_frame(views[0]), stamp_s=stamp_s) for stamp_s in stamps_s]
    assert not any(e.ok or e.is_reset for e in estimate_all(odometry, black))
    again = [replace(elsewhere(40 + k), stamp_s=0.1 + MAX_LOST_S + k / 30) for k in range(2)]
    restarted, after = estimate_all(odometry, again)
    assert restarted.ok
    assert restarted.is_reset
    np.testing.assert_array_equal(restarted.T_world_camera, before.T_world_camera)
    assert after.ok
    assert not after.is_reset
    assert_close(
        after.T_reference_camera,
        inverse(BRISK.pose_at(40 / 30)) @ BRISK.pose_at(41 / 30),
        0.001,
        0.03,
    )


def test_a_first_keyframe_without_a_match_is_dropped_soon(views: list[RgbdFrame]) -> None:
    odometry = DirectOdometry()
    estimates = estimate_all(odometry, [views[0], *(elsewhere(40 + k) for k in range(6))])
    assert [e.ok for e in estimates] == [True, *[False] * MAX_FAILURES, True, True, True]
    assert [e.is_reset for e in estimates].index(True) == 1 + MAX_FAILURES


def test_without_a_usable_frame_the_old_keyframes_are_kept(
    views: list[RgbdFrame],
) -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, views[:2])
    stamps_s = np.arange(2 / 30, 1.0 + MAX_LOST_S, 0.2)
    black = [replace(make_empty_frame(views[0]), stamp_s=stamp_s) for stamp_s in stamps_s]
    lost = estimate_all(odometry, black)
    assert not any(e.ok or e.is_reset for e in lost)
    found = odometry.estimate(replace(views[2], stamp_s=1.0 + MAX_LOST_S))
    assert found.ok
    assert not found.is_reset
    assert_close(found.T_world_camera, BRISK.pose_at(2 / 30), 0.0015, 0.05)


@pytest.mark.slow
def test_one_failure_does_not_count_for_the_next(views: list[RgbdFrame]) -> None:
    odometry = DirectOdometry()
    frames = [views[0], *[views[1], make_empty_frame(views[2])] * 10]
    estimates = [odometry.estimate(replace(f, stamp_s=0.3 * k)) for k, f in enumerate(frames)]
    assert [e.ok for e in estimates[1:]] == [True, False] * 10
    assert not any(e.is_reset for e in estimates)
