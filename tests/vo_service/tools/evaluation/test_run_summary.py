"""The summary at the end of a run."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import CameraCounters
from drivers.core.geometry import Trajectory, rigid_transform
from tests.vo_service.fakes import (
    FakeClock,
    ScriptedCamera,
    failed_estimate,
    good_estimate,
    make_frame,
)
from tests.vo_service.service_loop import make_service
from vo_service.frame_source import FrameSource
from vo_service.service_statistics import ServiceStatistics
from vo_service.tools.evaluation.run_summary import (
    LoopClosureSummary,
    RunSummary,
    evaluate_if_possible,
)

STAMPS_S = np.arange(40) / 30
PATH = np.array([rigid_transform(np.eye(3), [0.01 * k, 0.0, 0.02 * k]) for k in range(40)])
TRUTH = Trajectory(STAMPS_S, PATH)
EMPTY_SUMMARY = RunSummary(ServiceStatistics(FakeClock()), CameraCounters(), None)


def summarize(trajectory: Trajectory, truth: Trajectory | None = TRUTH) -> RunSummary:
    evaluation = evaluate_if_possible(trajectory, truth, STAMPS_S)
    return RunSummary(ServiceStatistics(FakeClock()), CameraCounters(), evaluation)


def test_with_and_without_truth_the_keys_are_the_same_and_json_takes_the_values() -> None:
    with_truth = summarize(TRUTH).as_json()
    assert list(EMPTY_SUMMARY.as_json()) == list(with_truth)
    assert json.loads(json.dumps(with_truth, allow_nan=False)) == with_truth
    assert {"frames", "failed", "skipped", "stage_ms", "cpu_ms_per_frame"} < set(with_truth)


def test_failed_frames_lower_the_coverage_and_are_no_errors() -> None:
    half = summarize(Trajectory(STAMPS_S[:20], PATH[:20])).as_json()
    assert half["coverage"] == 0.5
    for key in ("ate_rmse_m", "mean_global_error_m", "rpe_frame_m", "rpe_frame_deg"):
        assert half[key] == pytest.approx(0.0, abs=1e-6)


def test_without_a_pose_or_a_truth_there_is_nothing_to_evaluate(
    caplog: pytest.LogCaptureFixture,
) -> None:
    empty = Trajectory(np.empty(0), np.empty((0, 4, 4)))
    assert summarize(empty).evaluation is None
    assert summarize(TRUTH, truth=None).evaluation is None
    assert caplog.records == []


def test_a_truth_of_another_time_is_reported_and_leaves_the_other_figures(
    caplog: pytest.LogCaptureFixture,
) -> None:
    other_truth = Trajectory(STAMPS_S + 1e6, PATH)
    assert summarize(TRUTH, other_truth).as_json()["ate_rmse_m"] is None
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_skipped_counts_unreadable_and_stale_frames_failed_the_lost_ones() -> None:
    camera = ScriptedCamera([make_frame(0, 1.0), make_frame(1, 1.0), make_frame(2, 2.0)])
    with camera:
        service = make_service(
            FrameSource(camera), [], [good_estimate(np.eye(4)), failed_estimate()]
        )
        service.run(threading.Event())
    metrics = RunSummary(service.statistics, CameraCounters(skipped=3, dropped=5), None).as_json()
    counts = [metrics[key] for key in ("frames", "failed", "skipped", "dropped")]
    assert counts == [2, 1, 1 + 3, 5]


def test_the_table_has_a_line_for_each_metric() -> None:
    assert len(EMPTY_SUMMARY.as_table().splitlines()) == 8
    assert len(summarize(TRUTH).as_table().splitlines()) == 8 + 10


LOOP_CLOSURE_KEYS = (
    "map_keyframes",
    "loop_closures",
    "optimized_ate_rmse_m",
    "optimized_mean_global_error_m",
)
DRIFTING = Trajectory(STAMPS_S, PATH @ PATH)


def test_loop_closure_adds_keys() -> None:
    loop_closure = LoopClosureSummary(12, 5, evaluate_if_possible(TRUTH, TRUTH, STAMPS_S))
    plain = summarize(DRIFTING)
    summary = replace(plain, loop_closure=loop_closure)
    metrics = summary.as_json()
    assert {key: metrics.pop(key) for key in LOOP_CLOSURE_KEYS} == {
        "map_keyframes": 12,
        "loop_closures": 5,
        "optimized_ate_rmse_m": pytest.approx(0.0, abs=1e-6),
        "optimized_mean_global_error_m": pytest.approx(0.0, abs=1e-6),
    }
    assert metrics == plain.as_json()
    assert metrics["ate_rmse_m"] > 0.01
    *lines, last_row, _, _ = (line.split() for line in summary.as_table().splitlines())
    assert lines == [line.split() for line in plain.as_table().splitlines()]
    assert last_row == ["keyframes,", "loop", "closures", "12,", "5"]


def test_without_truth_loop_closures_are_counted_and_errors_are_null() -> None:
    loop_closure = LoopClosureSummary(12, 5, None)
    assert list(loop_closure.as_json().values()) == [12, 5, None, None]
    assert [label for label, _ in loop_closure.rows()] == ["keyframes, loop closures"]
