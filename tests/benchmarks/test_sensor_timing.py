"""Learned timing of random virtual Kinects, and of recordings that begin later."""

import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import sensor_timing
from benchmarks.__main__ import main
from benchmarks.harness import Json
from benchmarks.sensor_timing import (
    MAX_READOUT_S,
    RandomSensor,
    compare_timing,
    format_row,
    format_summary,
    make_random_sensor,
    measure_start,
    tell_exactly,
    tell_nothing,
)
from benchmarks.tracking import Accuracy, TrackedSequence
from drivers.camera import PinholeCamera, TimingSource
from drivers.core import InputError
from tests.vo_service.fakes import good_estimate, make_frame
from vo_service.types.estimate import OnlineTiming
from vo_service.types.odometry_update import TrackingState

SMALL = PinholeCamera(160, 120, 131.25, 131.25, 79.5, 59.5)
GOOD = Accuracy(frames=90, failed=0, resets=0, ate_m=0.002, global_m=0.003, rpe_1s_m=0.001)


def small_sensor(seed: int, duration_s: float) -> RandomSensor:
    sensor = make_random_sensor(seed, duration_s)
    return replace(sensor, config=replace(sensor.config, camera=SMALL, texel_m=0.05))


def learn(readout_ms: list[float], truth_ms: float = 20.0) -> Json:
    """Three frames a second; the published sigma of the readout is 1 ms, the delay is right."""
    timings = [OnlineTiming(1e-3 * ms, 0.01, 0.001, 0.0005, "learned") for ms in readout_ms]
    tracked = TrackedSequence(
        np.arange(len(timings)) / 3 + 100.0,
        [replace(good_estimate(np.eye(4)), timing=timing) for timing in timings],
        [TrackingState.TRACKING] * len(timings),
        np.zeros(len(timings), np.int64),
        np.zeros(len(timings)),
        np.zeros(len(timings)),
    )
    compared = compare_timing(tracked, (1e-3 * truth_ms, 0.01))
    return {"known": asdict(GOOD), "unknown": asdict(GOOD), **compared}


def test_sensors_differ_between_seeds_and_are_the_same_in_every_run() -> None:
    sensors = [make_random_sensor(seed, 20.0) for seed in range(100)]
    assert sensors[7] == make_random_sensor(7, 20.0)
    readouts_s = np.array([sensor.config.timing.readout_s for sensor in sensors])
    assert (readouts_s.min(), readouts_s.max()) == pytest.approx((0.0, MAX_READOUT_S), abs=0.002)
    delays_s = np.array([sensor.config.timing.skew_s for sensor in sensors])
    assert (delays_s.min(), delays_s.max()) == pytest.approx((-0.010, 0.015), abs=0.002)
    shifts_px = np.hypot(*np.array([sensor.shift_px for sensor in sensors]).T)
    assert 2.5 < shifts_px.max() <= 3.7


def test_a_negative_seed_is_a_clear_error() -> None:
    with pytest.raises(InputError, match="seed must be at least 0"):
        make_random_sensor(-1, 20.0)


def test_depth_is_shifted_without_readings_beyond_the_border() -> None:
    frame = make_frame(0)
    frame.depth_raw[:] = np.arange(48).reshape(6, 8) + 1
    shifted = replace(make_random_sensor(1, 1.0), shift_px=(2, -1)).measure(frame).depth_raw
    np.testing.assert_array_equal(shifted[:5, 2:], frame.depth_raw[1:, :6])
    assert not shifted[5].any()
    assert not shifted[:, :2].any()


def test_an_untold_frame_has_nothing_of_its_timing() -> None:
    frame = replace(make_frame(0), readout_s=0.02, skew_s=0.01)
    untold = tell_nothing(frame)
    assert (untold.readout_s, untold.skew_s) == (0.0, 0.0)
    assert untold.timing_prior is not None
    assert untold.timing_prior.source is TimingSource.UNKNOWN
    exact = tell_exactly(replace(frame, timing_prior=untold.timing_prior))
    assert (exact.readout_s, exact.skew_s, exact.timing_prior) == (0.02, 0.01, None)


def test_timing_has_settled_when_it_stays_near_the_truth() -> None:
    result = learn([0.0, 19.0, 25.0, 18.5, 21.0, 20.0])
    assert result["settling_s"] == pytest.approx(1.0)
    assert result["learned_s"] == pytest.approx((0.020, 0.010))
    assert learn([20.0, 20.0, 23.0])["settling_s"] is None
    assert learn([20.0])["settling_s"] == 0.0


def test_the_timing_is_compared_with_its_sigma_once_a_second() -> None:
    result = learn([0.0, 0.0, 22.9, 0.0, 0.0, 23.1, 20.0])
    assert (result["seconds"], result["consistent"]) == (3, 2)


def test_the_summary_counts_sequences_with_failed_frames_and_weighs_seconds() -> None:
    good, bad = learn([20.0] * 9), learn([0.0] * 3)
    bad["unknown"] = asdict(replace(GOOD, failed=1, ate_m=0.008))
    summary = format_summary([good, good, bad])
    assert "3 seeds: median ATE ratio 1.00" in summary
    assert "with failed frames or a reset 1 " in summary
    assert "within 3 sigmas 85.7 %" in summary
    cells = format_row("7", bad).split()
    assert cells[-8:] == ["never", "0%", "2.0", "8.0", "4.00", "0,", "1", "0"]


@pytest.mark.slow
def test_a_measured_sequence_is_not_rendered_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sensor_timing, "make_random_sensor", small_sensor)
    arguments = ["sensor_timing", "learned", str(tmp_path), "--seeds", "5", "--seconds", "0.4"]
    arguments += ["--processes", "1"]
    assert main(arguments) == 0
    first = capsys.readouterr()
    assert first.err.count("rendered") == 1
    assert first.out.splitlines()[1].split()[0] == "5-0.4s"
    assert "1 seeds: median ATE ratio" in first.out
    shutil.rmtree(tmp_path / "5-0.4s")
    assert main(arguments) == 0
    assert not (tmp_path / "5-0.4s").exists()
    assert capsys.readouterr().out == first.out


@pytest.mark.slow
def test_a_recording_is_measured_from_a_later_frame_on(recording: Path) -> None:
    result = measure_start("direct", recording, 5)
    assert [result[key]["frames"] for key in ("known", "ignored", "learned")] == [7, 7, 7]
    with pytest.raises(InputError, match="has no frame 12; begin at one of 0 to 11"):
        measure_start("direct", recording, 12)
