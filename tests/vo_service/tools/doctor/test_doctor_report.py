"""The packed report is complete or does not exist."""

import logging
import tarfile
from pathlib import Path

import pytest

from drivers.core import InputError, UserFacingError
from tests.full_disk import limit_file_size
from tests.vo_service.tools.doctor.doctor_fakes import make_usb_device, make_usb_interface
from vo_service.tools.doctor.report import (
    collect_versions,
    format_usb_listing,
    open_bug_report,
)


def text_of(file: Path, name: str) -> str:
    """Return the text of one member."""
    with tarfile.open(file) as archive:
        opened = archive.extractfile(name)
        assert opened is not None
        return opened.read().decode()


def test_the_log_is_detailed_in_the_report_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, console = logging.getLogger(), logging.StreamHandler()
    before = root.level
    root.addHandler(console)
    try:
        with open_bug_report(tmp_path / "kinect.tar.gz"):
            logging.getLogger("drivers.freenect").debug("a detail")
            logging.getLogger("numba.core").debug("a foreign detail")
    finally:
        root.removeHandler(console)
    text = text_of(tmp_path / "kinect.tar.gz", "kinect/log.txt")
    assert "a detail" in text
    assert "foreign" not in text
    assert "detail" not in capsys.readouterr().err
    assert root.level == before


def test_an_interrupted_report_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), open_bug_report(tmp_path / "kinect.tar.gz"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_error_not_one_for_each_line_of_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with (
        pytest.raises(UserFacingError, match="the disk is full"),
        limit_file_size(0),
        open_bug_report(tmp_path / "kinect.tar.gz"),
    ):
        logging.getLogger("drivers.freenect").debug("a detail")
    assert capsys.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kinect.zip", "end in .tar.gz"),
        ("there.tar.gz", "already exists"),
        ("nowhere/kinect.tar.gz", "cannot be written"),
    ],
)
def test_an_invalid_file_is_rejected_at_once(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "there.tar.gz").write_text("")
    with pytest.raises(InputError, match=message), open_bug_report(tmp_path / name):
        pass


@pytest.mark.subprocess
def test_the_versions_include_python_the_system_and_libraries() -> None:
    versions = collect_versions()
    assert {"kinect-vo", "python", "os", "kernel", "numpy", "libfreenect0.5"} <= versions.keys()
    assert versions["numpy"]


def test_the_usb_listing_has_speed_controller_and_driver(tmp_path: Path) -> None:
    assert format_usb_listing(tmp_path) == "the kernel lists no USB devices\n"
    device = make_usb_device(
        tmp_path, "0000:00:14.0/usb1/1-2", 1, 4, product="Xbox NUI Camera", speed="480"
    )
    make_usb_interface(device, 0, "ff", "gspca_kinect")
    line = format_usb_listing(tmp_path)
    assert "bus   1 device   4" in line
    assert "480 Mbit/s  controller 0000:00:14.0  Xbox NUI Camera" in line
    assert line.endswith("drivers gspca_kinect\n")
