"""Recordings in MCAP and bags, through the commands."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line

pytestmark = pytest.mark.slow


def trajectory(kinect_vo: KinectVo, recording: Path) -> bytes:
    file = recording.parent / f"{recording.name}.txt"
    outcome = kinect_vo("replay", recording, "--no-publish", "--trajectory", file)
    assert outcome.code == 0, outcome.err
    return file.read_bytes()


def test_a_converted_recording_gives_the_same_trajectory(
    copy_recording: Callable[..., Path], tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder, bag = copy_recording(), tmp_path / "a"
    outcome = kinect_vo("convert", folder, bag, "--format", "ros2")
    assert outcome.out == f"12 frames in {bag} (ros2)\n"
    expected = trajectory(kinect_vo, folder)
    assert expected.count(b"\n") == 12
    assert trajectory(kinect_vo, bag) == expected


def test_the_topics_are_named_and_the_true_poses_are_compared(
    copy_recording: Callable[..., Path], tmp_path: Path, kinect_vo: KinectVo
) -> None:
    file = tmp_path / "a.mcap"
    kinect_vo("convert", copy_recording(), file)
    outcome = kinect_vo(
        "replay", file, "--no-publish", "--json", "--trajectory", tmp_path / "t.txt"
    )
    assert f"{file}: color /camera/rgb/image_raw/compressed, depth /camera/" in outcome.err
    replayed = json.loads(outcome.out)
    evaluated = json.loads(kinect_vo("evaluate", tmp_path / "t.txt", file, "--json").out)
    assert replayed["ate_rmse_m"] == pytest.approx(evaluated["ate_rmse_m"], abs=1e-6)
    assert evaluated["frames"] == 12


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["record", "new.bag"], "new.bag: bags are not recorded live; record an .mcap and use"),
        (["record", "new", "--raw"], "--raw is for FILE.mcap; a folder without --jpeg is lossless"),
        (["record", "new.mcap", "--raw", "--jpeg"], "--jpeg and --raw contradict each other"),
        (["replay", "gone.mcap"], "gone.mcap: no such file; check the path"),
    ],
)
def test_wrong_input_is_one_line(command: list[str], message: str, kinect_vo: KinectVo) -> None:
    assert_one_line(kinect_vo(*command), 2, f"error: {message}")
