"""Figures of the loop: rates over the last seconds, medians over the run."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from tests.vo_service.fakes import FakeClock, failed_estimate, good_estimate, make_frame
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.service_statistics import ServiceStatistics
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate


def result(
    estimate: Estimate,
    stage_ms: float = 1.0,
    latency_s: float = 0.01,
    seen: RgbdFrame | None = None,
) -> OdometryUpdate:
    stamped = StampedFrame(seen or make_frame(0), 0.0)
    return OdomFrame().update(stamped, estimate, {"surf": stage_ms}, latency_s)


def run(count: int, period_s: float) -> tuple[ServiceStatistics, FakeClock]:
    clock = FakeClock()
    statistics = ServiceStatistics(clock)
    for _ in range(count):
        clock.now_s += period_s
        statistics.add(result(good_estimate(np.eye(4))), cpu_ms=5.0)
    return statistics, clock


def test_before_the_first_frame_everything_is_zero() -> None:
    statistics = ServiceStatistics()
    latency = statistics.make_latency_report({})
    assert (latency.fps, latency.p50_ms, latency.p99_ms) == (0.0, 0.0, 0.0)
    assert (statistics.mean_fps, statistics.cpu_ms_per_frame, statistics.stage_ms) == (0.0, 0.0, {})


@pytest.mark.parametrize("fps", [5.0, 30.0, 200.0])
@pytest.mark.parametrize("seconds", [0.5, 10.0])
def test_the_rate_is_right_from_the_first_frames(fps: float, seconds: float) -> None:
    statistics, _ = run(round(fps * seconds) + 1, 1 / fps)
    assert statistics.make_latency_report({}).fps == pytest.approx(fps, rel=1e-6)
    assert statistics.mean_fps == pytest.approx(fps, rel=1e-6)


def test_the_rate_falls_when_frames_stop() -> None:
    statistics, clock = run(61, 1 / 30)
    clock.now_s += 1.0
    assert statistics.make_latency_report({}).fps < 20.0
    clock.now_s += 1.5
    assert statistics.make_latency_report({}).fps == 0.0


def test_latencies_are_percentiles_of_the_last_hundred_frames() -> None:
    statistics = ServiceStatistics(FakeClock())
    for latency_ms in [9000.0] * 50 + list(range(1, 101)):
        statistics.add(result(good_estimate(np.eye(4)), latency_s=latency_ms / 1e3), cpu_ms=1.0)
    latency = statistics.make_latency_report({})
    assert latency.p50_ms == pytest.approx(50.5)
    assert latency.p99_ms == pytest.approx(99.01)


def test_processor_times_are_medians() -> None:
    statistics = ServiceStatistics(FakeClock())
    for cpu_ms in (900.0, 5.0, 6.0, 7.0, 6.0):
        statistics.add(result(good_estimate(np.eye(4)), stage_ms=cpu_ms / 2), cpu_ms)
    assert statistics.cpu_ms_per_frame == 6.0
    assert statistics.stage_ms == {"surf": 3.0}


def test_stage_means_are_of_the_last_hundred_frames_and_add_up() -> None:
    statistics = ServiceStatistics(FakeClock())
    of_frames = [{"align": 900.0}] * 50 + [{"align": 2.0}] * 90 + [{"align": 2.0, "new": 4.0}] * 10
    for stage_ms in of_frames:
        statistics.add(replace(result(good_estimate(np.eye(4))), stage_ms=stage_ms), cpu_ms=1.0)
    latency = statistics.make_latency_report({})
    assert latency.stage_ms == {"align": 2.0, "new": 4.0}
    assert latency.stage_mean_ms == pytest.approx({"align": 2.0, "new": 0.4})


def test_failed_frames_are_counted() -> None:
    statistics = ServiceStatistics(FakeClock())
    for estimate in (
        good_estimate(np.eye(4)),
        failed_estimate(),
        replace(good_estimate(np.eye(4)), inliers=16),
    ):
        statistics.add(result(estimate), cpu_ms=1.0)
    assert (statistics.frames, statistics.failed) == (3, 1)


def statistics_of(frames: Iterable[RgbdFrame]) -> ServiceStatistics:
    statistics = ServiceStatistics(FakeClock())
    for seen in frames:
        statistics.add(result(good_estimate(np.eye(4)), seen=seen), cpu_ms=1.0)
    return statistics


def test_skew_is_the_median_of_depth_minus_color() -> None:
    skews_s = [0.004, -0.9, 0.005, 0.006, 0.9]
    statistics = statistics_of(
        replace(make_frame(k), skew_s=skew) for k, skew in enumerate(skews_s)
    )
    assert statistics.skew_ms == pytest.approx(5.0)


def test_regular_stamps_have_no_jitter_despite_missing_frames() -> None:
    statistics = statistics_of(make_frame(seq, seq / 30) for seq in (0, 1, 2, 5, 6, 9))
    assert statistics.jitter_ms == pytest.approx(0.0, abs=1e-9)


def test_jitter_is_the_standard_deviation_of_the_interval() -> None:
    stamps_s = [0.0, 0.032, 0.066, 0.098, 0.132]
    statistics = statistics_of(make_frame(seq, stamp_s) for seq, stamp_s in enumerate(stamps_s))
    assert statistics.jitter_ms == pytest.approx(1.0)


def test_the_time_without_a_camera_is_no_jitter() -> None:
    stamps_s = [0.0, 1 / 30, 40.0, 40.0 + 1 / 30]
    statistics = statistics_of(make_frame(seq, stamp_s) for seq, stamp_s in enumerate(stamps_s))
    assert statistics.jitter_ms == pytest.approx(0.0, abs=1e-9)
