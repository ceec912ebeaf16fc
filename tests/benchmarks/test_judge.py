"""The judge of the odometry: its cases, its figures, and its table."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from benchmarks import judge
from benchmarks.harness import Json, ResultCache
from benchmarks.judge import (
    PERTURBATIONS,
    STARTS,
    Case,
    find_recordings,
    format_judgement,
    make_cases,
    read_reference,
    recording_cases,
    run_cases,
)
from benchmarks.rendered_sequences import VirtualRecording, render
from benchmarks.tracking import TrackedSequence
from drivers.camera import PinholeCamera
from drivers.core import InputError
from drivers.core.geometry import Trajectory, rigid_transform
from drivers.synthetic.config import SyntheticConfig
from tests.vo_service.fakes import make_frame
from vo_service.odometry import warm_up
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import TrackingState

ROOM = Path("room")
TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)


def result(ate_m: float | None, failed: int = 0) -> Json:
    return {
        "ate_m": ate_m,
        "rpe_1s_m": ate_m,
        "failed": failed,
        "overconfident": 0,
        "cpu_ms": 3.0,
    }


def test_a_method_is_compiled_by_the_process_whose_parameters_are_changed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(warm_up, "ensure_compiled", pytest.fail)  # it starts other processes
    judge._warm_up("icp")


def estimate_at(x_m: float) -> Estimate:
    return Estimate(True, "", rigid_transform(np.eye(3), [x_m, 0, 0]), np.eye(4), np.eye(6))


def test_a_case_uses_every_third_frame_from_its_first_one_without_their_timing() -> None:
    case = Case("room", ROOM, "direct", first=2, step=3)
    frames = list(case.change(make_frame(seq) for seq in range(9)))
    assert [frame.seq for frame in frames] == [2, 5, 8]
    assert all(frame.readout_s == frame.skew_s == 0 for frame in frames)


def test_a_case_ends_before_its_end() -> None:
    case = Case("room", ROOM, "direct", first=2, end=4)
    assert [frame.seq for frame in case.change(make_frame(seq) for seq in range(9))] == [2, 3]


def test_a_told_case_keeps_the_timing_as_exact() -> None:
    (frame,) = Case("room", ROOM, "direct", is_told=True).change([make_frame(0)])
    assert frame.timing_prior is None


def test_keys_of_different_cases_differ_and_do_not_name_the_folder() -> None:
    cases = [
        Case("room", ROOM, "direct"),
        Case("room", ROOM, "surf"),
        Case("room", ROOM, "direct", is_told=True),
        Case("room", ROOM, "direct", perturbation=1),
        Case("room", ROOM, "direct", first=1),
        Case("room", ROOM, "direct", step=3),
        Case("room", ROOM, "direct", end=3),
    ]
    assert len({case.key for case in cases}) == len(cases)
    assert Case("room", Path("elsewhere/room"), "direct").key == cases[0].key


@pytest.mark.slow
def test_a_recording_is_judged_with_perturbations_and_from_later_frames(tmp_path: Path) -> None:
    config = SyntheticConfig(camera=TINY, duration_s=0.3, texel_m=0.05)
    render(tmp_path / "room", VirtualRecording(config))
    cases = recording_cases(tmp_path / "room", ("surf", "icp"))
    untold = [case for case in cases if case.method == "surf" and not case.is_told]
    assert len(untold) == 1 + len(PERTURBATIONS) + len(STARTS)
    results = run_cases(cases[:2], ResultCache(tmp_path), processes=1)
    assert [results[case.key]["frames"] for case in cases[:2]] == [9, 9]


def test_the_row_of_a_group_has_medians_and_ratios() -> None:
    runs = [Case("room", ROOM, "direct", perturbation=seed) for seed in range(3)]
    other = Case("room", ROOM, "surf")
    results = {
        case.key: result(ate_m) for case, ate_m in zip(runs, (2e-3, 9e-3, 1e-3), strict=True)
    }
    results[other.key] = result(4e-3)
    reference = {runs[0].key: result(4e-3)}
    row = format_judgement([*runs, other], results, "direct", reference).splitlines()[1].split()
    assert row == ["room", "3", "2.0", "9.0", "2.0", "0", "0", "3.0", "0.50", "surf", "4.0", "0.50"]


def test_a_method_that_loses_more_frames_is_not_the_best_other_one() -> None:
    run, easy = Case("room", ROOM, "direct"), Case("room", ROOM, "surf")
    results = {run.key: result(5e-3), easy.key: result(1e-3, failed=10)}
    assert "surf" not in format_judgement([run, easy], results, "direct")


def test_poses_further_off_than_three_sigmas_are_counted() -> None:
    stamps_s = np.arange(3.0)
    truth = Trajectory(stamps_s, np.repeat(np.eye(4)[None], 3, axis=0))
    tracked = TrackedSequence(
        stamps_s,
        [estimate_at(0.0), estimate_at(0.029), estimate_at(0.031)],
        [TrackingState.TRACKING] * 3,
        np.zeros(3, np.int64),
        np.full(3, 0.01),
        np.zeros(3),
    )
    assert tracked.count_overconfident(truth) == 1


def test_a_folder_without_recordings_and_a_broken_reference_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no recordings"):
        find_recordings(tmp_path)
    broken = tmp_path / "results.json"
    broken.write_text("[")
    with pytest.raises(InputError, match=r"results\.json: cannot read it"):
        read_reference(broken)


def test_only_what_is_named_is_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[str] = []

    def render_all(_kept: Path, scenes: Mapping[str, object], _processes: int) -> dict[str, Path]:
        rendered.extend(scenes)
        return {name: tmp_path / name for name in scenes}

    monkeypatch.setattr(judge, "render_all", render_all)
    monkeypatch.setattr(judge, "sensor_cases", lambda sensors, _methods: list(sensors))
    only = ["stereo-1", "wall"]
    make_cases(tmp_path, tmp_path, ["sensors", "scenes"], "tuning", ["direct"], 1, only)
    assert rendered == only
