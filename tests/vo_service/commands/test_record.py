"""``record``: what was recorded replays as the source did."""

import json
from pathlib import Path

import pytest

from tests.conftest import FRAMES
from tests.vo_service.commands.command_line import call


def test_a_recording_of_a_recording_replays_to_the_same_bytes(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    outcome = call(capfd, "record", "--camera", f"tum:{recording}", copy)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out == f"{FRAMES} frames in {copy}\n"
    for source, written in ((recording, tmp_path / "a.txt"), (copy, tmp_path / "b.txt")):
        call(capfd, "replay", source, "--no-publish", "--trajectory", written)
    assert (tmp_path / "a.txt").read_bytes() == (tmp_path / "b.txt").read_bytes()


def test_the_ground_truth_goes_with_it(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    call(capfd, "record", "--camera", f"tum:{recording}", tmp_path / "copy")
    truth = (tmp_path / "copy" / "groundtruth.txt").read_bytes()
    assert truth == (recording / "groundtruth.txt").read_bytes()


def test_it_stops_after_the_seconds_of_the_cameras_time(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "short"
    outcome = call(capfd, "record", "--camera", f"tum:{recording}", "--seconds", "0.2", folder)
    assert outcome.out == f"6 frames in {folder}\n"
    assert len((folder / "associations.txt").read_text().splitlines()) == 1 + 6


def test_a_recording_in_jpeg_can_be_replayed(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "small"
    call(capfd, "record", "--camera", f"tum:{recording}", "--jpeg", folder)
    assert len(list((folder / "rgb").glob("*.jpg"))) == FRAMES
    outcome = call(capfd, "replay", folder, "--no-publish", "--json")
    assert json.loads(outcome.out)["failed"] == 0
