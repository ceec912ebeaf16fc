"""Hard cases, with an odometry of scripted errors, and the drift of a stationary camera."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hard_cases import (
    SCENES,
    STILL,
    SceneResult,
    StaticView,
    evaluate_scene,
    format_creep,
    longest_gap_s,
    measure_drift,
    read_scene,
)
from benchmarks.rendered_sequences import VirtualRecording, render
from benchmarks.tracking import TrackedSequence, open_frames_with_truth, track
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import PluginGroup
from drivers.core.geometry import Trajectory, rigid_transform, so3_exp
from drivers.faulty_camera import Fault, FaultKind
from drivers.synthetic.config import MotionKind, SyntheticConfig
from tests.vo_service.fakes import make_frame
from vo_service.types.estimate import Estimate

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
    render(place, VirtualRecording(CONFIG))
    return place


def make_method(monkeypatch: pytest.MonkeyPatch, odometry: ScriptedEstimates) -> str:
    """Register an odometry as a method; return its name."""
    monkeypatch.setattr(PluginGroup, "__getitem__", lambda methods, name: lambda *_: odometry)
    return "make_method"


def tracked(method: str, folder: Path) -> tuple[TrackedSequence, Trajectory]:
    with open_frames_with_truth(folder) as (frames, truth):
        return track(method, frames), truth


def measure(method: str, folder: Path) -> SceneResult:
    return evaluate_scene(*tracked(method, folder), CONFIG)


def test_lost_frames_and_the_recovery_time_are_reported(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    method = make_method(
        monkeypatch, ScriptedEstimates(lambda seq: 0.0, is_lost=lambda seq: 10 <= seq < 18)
    )
    case = measure(method, folder)
    assert (case.frames, case.lost, case.degraded, case.gross) == (30, 8, 0, 0)
    assert case.longest_gap_s == pytest.approx(8 / 30, abs=1e-5)
    assert case.recovery_s == pytest.approx(3 / 30, abs=1e-5)
    assert case.max_error_m is not None
    assert case.max_error_m < 0.001


def test_a_jump_is_a_gross_error_and_counted_apart_while_tracking(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    odometry = ScriptedEstimates(lambda seq: 0.06 * (seq >= 5) + 0.06 * (seq >= 20))
    case = measure(make_method(monkeypatch, odometry), folder)
    assert (case.gross, case.gross_tracking, case.degraded) == (2, 2, 0)
    unsure = replace(odometry, inliers=lambda seq: 10 if seq == 20 else 100)
    case = measure(make_method(monkeypatch, unsure), folder)
    assert (case.gross, case.gross_tracking, case.degraded) == (2, 1, 1)
    assert "2 (1)" in case.format_row("case")


def test_without_recovery_its_time_is_infinite(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    method = make_method(
        monkeypatch, ScriptedEstimates(lambda seq: 0.0, is_lost=lambda seq: seq >= 10)
    )
    case = measure(method, folder)
    assert case.recovery_s == np.inf
    assert "inf" in case.format_row("case")
    lost = measure(
        make_method(monkeypatch, ScriptedEstimates(lambda seq: 0.0, lambda seq: True)),
        folder,
    )
    assert (lost.lost, lost.ate_m, lost.gross) == (30, None, 0)


def test_the_tracked_distance_of_a_creep(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    stands = tracked(make_method(monkeypatch, ScriptedEstimates(lambda seq: 0.0)), folder)
    assert format_creep(*stands).split() == ["30", "0", "0.00", "of", "0.97", "mm:", "0.0", "%"]


def test_a_pause_between_frames_is_time_without_a_pose() -> None:
    stamps_s = np.array([0.0, 0.1, 0.2, 1.2, 1.3])
    assert longest_gap_s(stamps_s, np.ones(5, np.bool_)) == pytest.approx(0.9)
    assert longest_gap_s(stamps_s[:3], np.array([True, False, False])) == pytest.approx(0.1)


def test_every_scene_has_a_sequence() -> None:
    assert {read_scene(name).loop for name in (*SCENES, STILL)} == {False}


# Six frames.
STILL_CONFIG = SyntheticConfig(camera=TINY, duration_s=0.2, texel_m=0.05, motion=MotionKind.STILL)


class DriftingOdometry:
    """An odometry that drifts by a millimeter and a tenth of a degree per frame; one is lost."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Return the drifted pose."""
        turn = so3_exp([0.0, 0.0, np.radians(0.1 * frame.seq)])
        T = rigid_transform(turn, [0.5 + 0.001 * frame.seq, 0.0, 0.0])
        return Estimate(frame.seq != 1, "", T, np.eye(4), np.eye(6))


def test_the_drift_of_each_minute_is_from_the_first_pose_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        PluginGroup, "__getitem__", lambda methods, name: lambda *_: DriftingOdometry()
    )
    frames = (replace(make_frame(0), seq=seq) for seq in range(6))
    minutes = [cells[:-1] for cells in measure_drift("creeping", frames, 3)]  # without the time
    one_m, one_deg = 0.001, 0.1
    first, rms = np.sqrt(np.mean([0, 4])), np.sqrt(np.mean([0, 4, 9, 16, 25]))
    sizes = [(2, first, 0), (5, rms, 3)]  # largest, RMS, from the first minute to the last
    for number, (cells, of_minute) in enumerate(zip(minutes, sizes, strict=True), 1):
        assert cells[:2] == (3 * number, 1)
        expected = [each * unit for each in of_minute for unit in (one_m, one_deg)]
        np.testing.assert_allclose(cells[2:], expected, atol=1e-9)


def test_frames_of_a_static_view_differ_only_in_their_noise() -> None:
    view = StaticView.render(STILL_CONFIG)
    frames = list(view.frames(8))
    assert [frame.seq for frame in frames] == list(range(8))
    np.testing.assert_array_equal(frames[5].color_bgr, view.frame(5).color_bgr)
    np.testing.assert_array_equal(frames[5].depth_raw, view.frame(5).depth_raw)
    assert np.any(frames[0].color_bgr != frames[1].color_bgr)
    assert np.any(frames[0].depth_raw != frames[1].depth_raw)
    both = (frames[0].depth_raw > 0) & (frames[1].depth_raw > 0)
    assert np.median(np.abs(frames[0].depth_m - frames[1].depth_m)[both]) < 0.03
