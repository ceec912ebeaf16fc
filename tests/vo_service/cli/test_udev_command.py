"""`kinect-vo udev`: what it prints and what it leaves behind."""

from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import KinectVo
from vo_service.tools.install.udev import MODPROBE_FILE, RULES_FILE, list_system_files


def test_installing_into_a_tree_prints_the_written_files(
    tmp_path: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("udev", "install", "--root", tmp_path)
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert outcome.out == (
        f"{tmp_path / RULES_FILE}: written\n{tmp_path / MODPROBE_FILE}: written\n"
    )
    assert "blacklist gspca_kinect\n" in (tmp_path / MODPROBE_FILE).read_text()


def test_existing_files_are_reported(tmp_path: Path, kinect_vo: KinectVo) -> None:
    kinect_vo("udev", "install", "--root", tmp_path)
    again = kinect_vo("udev", "install", "--root", tmp_path)
    assert again.code == 0
    assert again.out.count("was there already") == 2


def test_uninstalling_removes_both_files(tmp_path: Path, kinect_vo: KinectVo) -> None:
    kinect_vo("udev", "install", "--root", tmp_path)
    assert kinect_vo("udev", "uninstall", "--root", tmp_path).out.count("removed") == 2
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert kinect_vo("udev", "uninstall", "--root", tmp_path).out.count("was not there") == 2


def test_show_prints_the_files_to_install(kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("udev", "show")
    assert outcome.code == 0
    for file in list_system_files():
        assert f"# /{file.path}\n{file.text}" in outcome.out


@pytest.mark.parametrize(
    ("complaint", "message"),
    [("", "unplug the sensor"), ("udevadm is not installed here", "restart the computer")],
)
def test_the_advice_after_installing_depends_on_udev(
    complaint: str, message: str, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vo_service.cli.udev.install", lambda root: [])
    monkeypatch.setattr("vo_service.cli.udev.apply_rules", lambda: complaint)
    outcome = kinect_vo("udev", "install")
    assert outcome.code == 0
    assert message in outcome.out + outcome.err
