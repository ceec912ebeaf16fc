"""``replay`` that knows places again: what that gains, the file that it leaves, what it refuses."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core.geometry import read_trajectory
from tests.vo_service.cli.cli_runner import CommandResult, KinectVo, assert_one_line, run_subprocess
from tests.vo_service.cli.loop_recording import FRAME_COUNT, write_loop_recording
from vo_service.cli import replay

pytestmark = pytest.mark.subprocess

CopyRecording = Callable[..., Path]
GIVEN = ("--method", "surf", "--no-publish", "--optimized-trajectory")


@dataclass(frozen=True)
class Replayed:
    """A replay with loops of a method that drifts."""

    folder: Path
    corrected: Path
    outcome: CommandResult

    @property
    def figures(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.outcome.out)
        return found


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    place = tmp_path_factory.mktemp("replayed")
    folder = write_loop_recording(place / "there-and-back")
    corrected = place / "corrected.txt"
    return Replayed(
        folder, corrected, run_subprocess("replay", folder, *GIVEN, corrected, "--json")
    )


def test_the_optimized_trajectory_has_every_frame_from_identity_on(replayed: Replayed) -> None:
    assert (replayed.outcome.code, replayed.outcome.error_lines) == (0, "")
    found = read_trajectory(replayed.corrected)
    truth = read_trajectory(replayed.folder / "groundtruth.txt")
    assert len(found) == FRAME_COUNT
    np.testing.assert_array_equal(found.stamps_s, truth.stamps_s)
    np.testing.assert_allclose(found.T_world_camera[0], np.eye(4), atol=1e-9)


def test_loop_closure_reduces_the_trajectory_error(replayed: Replayed) -> None:
    figures = replayed.figures
    assert min(figures["map_keyframes"], figures["loop_closures"]) > 5
    assert figures["optimized_ate_rmse_m"] < figures["ate_rmse_m"]
    assert figures["optimized_mean_global_error_m"] < 0.6 * figures["mean_global_error_m"]


@pytest.mark.slow
def test_without_a_loss_loop_closure_does_not_change_published_and_written_poses(
    replayed: Replayed, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    written = tmp_path / "poses.txt"
    given = ("--method", "surf", "--no-publish", "--trajectory", written, "--json")
    figures = json.loads(kinect_vo("replay", replayed.folder, *given).out)
    assert figures["ate_rmse_m"] == replayed.figures["ate_rmse_m"]
    assert not {"map_keyframes", "loop_closures", "optimized_ate_rmse_m"} & set(figures)
    assert written.read_bytes() != replayed.corrected.read_bytes()


@pytest.mark.slow
def test_with_loop_closure_a_replay_repeats_bit_for_bit_in_another_process(
    replayed: Replayed, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    again = tmp_path / "again.txt"
    outcome = kinect_vo("replay", replayed.folder, *GIVEN, again)
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert again.read_bytes() == replayed.corrected.read_bytes()
    for label in ("keyframes, loop closures", "optimized ATE, RMSE", "optimized global error"):
        assert f"\n{label}  " in f"\n{outcome.out}"


@pytest.mark.slow
@pytest.mark.usefixtures("no_top_view")
def test_with_loop_closure_a_map_is_saved_at_the_optimized_poses(
    replayed: Replayed, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    given = ("--method", "surf", "--loop-closure", "--voxel-m", 0.04, "--memory-mb", 100)
    outcome = kinect_vo("reconstruct", replayed.folder, *given, "--output", tmp_path / "map")
    assert (outcome.code, outcome.error_lines) == (0, "")
    figures = json.loads((tmp_path / "map" / "reconstruction.json").read_text())
    assert figures["map_keyframes"] > 1
    assert f"loop_closures {figures['loop_closures']}" in " ".join(outcome.out.split())
    assert figures["loop_closures"] > 0
    written = (tmp_path / "map" / "trajectory.txt").read_bytes()
    assert written == replayed.corrected.read_bytes()


def test_an_unwritable_optimized_trajectory_is_rejected_before_the_run(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(replay, "prepare_kernels")
    file = tmp_path / "gone" / "poses.txt"
    outcome = kinect_vo("replay", recording, *GIVEN, file)
    assert_one_line(outcome, 2, f"{file}: cannot be written: there is no folder")
