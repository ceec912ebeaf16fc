"""``kinect-vo certificates`` as its user sees it."""

from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line


@pytest.mark.subprocess
def test_the_purpose_of_each_file_is_printed(tmp_path: Path, kinect_vo: KinectVo) -> None:
    names = ("--host", "localhost", "--robot", "robot1", "--reader", "tablet", "--operator", "desk")
    outcome = kinect_vo("certificates", tmp_path / "keys", *names)
    assert outcome.code == 0
    assert (
        f'{tmp_path}/keys/robot1: beside fleet-robot.json5 on the robot with prefix = "robot1"'
        in (outcome.out)
    )
    for name in ("localhost", "robot1", "tablet", "desk"):
        assert (tmp_path / "keys" / name / "tls.key").exists()
    assert "This is for a test network" in outcome.out


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("--reader", "a/b"), "is not a valid certificate name"),
        (("--reader", "same", "--operator", "same"), "same is given twice"),
        (("--reader", "fine", "--days", "0"), "is not a number of days"),
        (("--host", "bad host"), "is not a valid certificate name"),
    ],
)
def test_an_error_is_one_line_and_creates_nothing(
    tmp_path: Path, kinect_vo: KinectVo, names: tuple[str, ...], words: str
) -> None:
    assert_one_line(kinect_vo("certificates", tmp_path / "keys", *names), 2, words)
    assert not (tmp_path / "keys").exists()
