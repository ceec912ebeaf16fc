"""The table of hard cases, with an odometry of scripted errors."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hard_cases import CASES, case_config, format_row, measure_creep, measure_stationary
from benchmarks.rendered_sequences import render
from benchmarks.tracking import longest_gap_s, measure
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import PluginGroup
from drivers.synthetic import Fault, FaultKind, MotionKind, SyntheticConfig
from tests.vo_service.fakes import make_frame
from vo_service.types import Estimate

pytestmark = pytest.mark.slow

TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)
# A second at a millimeter per second: 30 frames; the camera is covered for some.
CONFIG = SyntheticConfig(
    camera=TINY,
    duration_s=1.0,
    texel_m=0.05,
    motion=MotionKind.CREEP,
    faults=(Fault(FaultKind.COVERED, 10, 5),),
)


@dataclass
class ScriptedEstimates:
    """An odometry with scripted estimates by frame number."""

    pose: Callable[[int], float]
    is_lost: Callable[[int], bool] = lambda seq: False
    inliers: Callable[[int], int] = lambda seq: 100

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Return the scripted pose to the right."""
        T, lost = np.eye(4), self.is_lost(frame.seq)
        T[0, 3] = self.pose(frame.seq)
        reason = "scripted" if lost else ""
        return Estimate(
            not lost, reason, T, np.eye(4), np.eye(6) * 1e-6, inliers=self.inliers(frame.seq)
        )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("hard") / "creep"
    render(place, CONFIG)
    return place


def make_method(monkeypatch: pytest.MonkeyPatch, odometry: ScriptedEstimates) -> str:
    """Register an odometry as a method; return its name."""
    monkeypatch.setattr(PluginGroup, "__getitem__", lambda methods, name: lambda *_: odometry)
    return "make_method"


def test_lost_frames_and_the_recovery_time_are_reported(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    method = make_method(
        monkeypatch, ScriptedEstimates(lambda seq: 0.0, is_lost=lambda seq: 10 <= seq < 18)
    )
    case = measure(method, folder, CONFIG)
    assert (case.frames, case.lost, case.degraded, case.gross) == (30, 8, 0, 0)
    assert case.longest_gap_s == pytest.approx(8 / 30, abs=1e-5)
    assert case.recovery_s == pytest.approx(3 / 30, abs=1e-5)
    assert case.max_error_m is not None
    assert case.max_error_m < 0.001


def test_a_jump_is_a_gross_error_and_counted_apart_while_tracking(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    odometry = ScriptedEstimates(lambda seq: 0.06 * (seq >= 5) + 0.06 * (seq >= 20))
    case = measure(make_method(monkeypatch, odometry), folder, CONFIG)
    assert (case.gross, case.gross_tracking, case.degraded) == (2, 2, 0)
    unsure = replace(odometry, inliers=lambda seq: 10 if seq == 20 else 100)
    case = measure(make_method(monkeypatch, unsure), folder, CONFIG)
    assert (case.gross, case.gross_tracking, case.degraded) == (2, 1, 1)
    assert "2 (1)" in format_row(case)


def test_without_recovery_its_time_is_infinite(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    method = make_method(
        monkeypatch, ScriptedEstimates(lambda seq: 0.0, is_lost=lambda seq: seq >= 10)
    )
    case = measure(method, folder, CONFIG)
    assert case.recovery_s == np.inf
    assert "inf" in format_row(case)
    lost = measure(
        make_method(monkeypatch, ScriptedEstimates(lambda seq: 0.0, lambda seq: True)),
        folder,
        CONFIG,
    )
    assert (lost.lost, lost.ate_m, lost.gross) == (30, None, 0)


def test_the_tracked_distance_of_a_creep(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    stands = measure_creep(make_method(monkeypatch, ScriptedEstimates(lambda seq: 0.0)), folder)
    assert stands.true_distance_m == pytest.approx(29 / 30 * 0.001, rel=1e-3)
    assert stands.tracked_distance_m == 0.0
    assert "0.0 %" in format_row(stands)


def test_standing_still_is_measured_from_the_first_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    method = make_method(
        monkeypatch, ScriptedEstimates(lambda seq: 0.5 - 0.01 * (seq == 3) + 0.002 * (seq == 5))
    )
    stood = measure_stationary(method, [replace(make_frame(0), seq=seq) for seq in range(6)])
    assert (stood.frames, stood.lost) == (6, 0)
    assert stood.max_error_m == pytest.approx(0.010)
    assert stood.end_m == pytest.approx(0.002)


def test_a_pause_between_frames_is_time_without_a_pose() -> None:
    stamps_s = np.array([0.0, 0.1, 0.2, 1.2, 1.3])
    assert longest_gap_s(stamps_s, np.ones(5, np.bool_)) == pytest.approx(0.9)
    assert longest_gap_s(stamps_s[:3], np.array([True, False, False])) == pytest.approx(0.1)


def test_every_case_has_a_sequence() -> None:
    assert {case_config(name).loop for name in CASES} == {False}
