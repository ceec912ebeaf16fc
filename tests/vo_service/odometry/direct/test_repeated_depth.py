"""A sensor whose depth is slower than its color: every second depth image is repeated."""

from dataclasses import replace

from drivers.camera import RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    STILL,
    add_noise,
    make_empty_frame,
    remove_depth,
    render_sequence,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.quality import NO_DEPTH
from vo_service.odometry.direct.repeated_depth import REPEATED, RepeatedDepthFilter
from vo_service.types.estimate import Estimate

NOISY = [add_noise(frame, k) for k, frame in enumerate(render_sequence(BRISK, 12))]


def reasons(frames: list[RgbdFrame]) -> list[str]:
    return [
        estimate.reason for estimate in estimate_all(RepeatedDepthFilter(DirectOdometry()), frames)
    ]


def repeat_every_second_depth(frames: list[RgbdFrame]) -> list[RgbdFrame]:
    return [replace(frame, depth_raw=frames[k - k % 2].depth_raw) for k, frame in enumerate(frames)]


def test_a_frame_with_repeated_depth_is_followed_by_its_brightness() -> None:
    estimates = estimate_all(
        RepeatedDepthFilter(DirectOdometry()), repeat_every_second_depth(NOISY)
    )
    for frame, estimate in zip(NOISY, estimates, strict=True):
        assert_close(estimate.T_world_camera, BRISK.pose_at(frame.stamp_s), 0.002, 0.1)
    assert [estimate.reason for estimate in estimates] == ["", REPEATED] * 6


def test_new_depth_and_a_repeated_frame_are_kept() -> None:
    assert set(reasons(NOISY)) == {""}
    assert set(reasons(render_sequence(STILL, 3))) == {""}


def test_missing_depth_is_not_called_repeated() -> None:
    assert reasons([NOISY[0], remove_depth(NOISY[1]), remove_depth(NOISY[2])])[1:] == [NO_DEPTH] * 2


def test_the_reason_of_a_lost_frame_is_kept() -> None:
    dark = replace(make_empty_frame(NOISY[1]), depth_raw=NOISY[0].depth_raw)
    lost: Estimate = estimate_all(RepeatedDepthFilter(DirectOdometry()), [NOISY[0], dark])[1]
    assert not lost.ok
    assert lost.reason != REPEATED
