"""Cameras by name, and the methods."""

from pathlib import Path

import pytest

from drivers.camera import Clock, PlaybackMode
from drivers.core import InputError
from drivers.registry import CAMERA_USAGES, CAMERAS, SENSORS, make_reconnecting, open_camera
from drivers.subprocess_camera.camera import SubprocessCamera


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))


def test_a_realtime_virtual_kinect_uses_the_host_clock() -> None:
    camera = open_camera("synthetic", playback_mode=PlaybackMode.REALTIME)
    assert (camera.name, camera.clock) == ("synthetic", Clock.MONOTONIC)


def test_a_recording_is_named_by_its_folder(tmp_path: Path) -> None:
    camera = open_camera(f"tum:{tmp_path}")
    assert (camera.name, camera.clock) == (f"tum:{tmp_path}", Clock.RECORDED)


def test_a_folder_may_have_a_colon_in_its_name() -> None:
    assert open_camera("tum:C:/desk").name == "tum:C:/desk"


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("kinekt", "camera 'kinekt' is unknown; use one of: freenect"),
        ("fakenect", "needs the folder of a dump: fakenect:FOLDER"),
        ("", "camera '' is unknown"),
        ("desk", "camera 'desk' is unknown"),
        ("tum", "needs a folder: tum:FOLDER"),
        ("tum:", "needs a folder: tum:FOLDER"),
        ("synthetic:7", "it takes no argument"),
    ],
)
def test_an_invalid_source_is_reported_with_the_valid_ones(source: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_camera(source)


def test_a_virtual_kinect_takes_no_camera_file() -> None:
    with pytest.raises(InputError, match=r"camera\.toml: the virtual Kinect takes no camera file"):
        open_camera("synthetic", camera_file="camera.toml")


@pytest.mark.parametrize(
    ("source", "clock"),
    [
        ("freenect", Clock.MONOTONIC),
        ("freenect:A00367A01234305A", Clock.MONOTONIC),
        ("openni2", Clock.MONOTONIC),
        ("openni2:1d27/0600@2/5", Clock.MONOTONIC),
        ("openni2:desk.oni", Clock.RECORDED),
        ("openni2:DESK.ONI", Clock.RECORDED),
        ("fakenect:desk", Clock.RECORDED),
    ],
)
def test_native_libraries_run_in_their_own_process(source: str, clock: Clock) -> None:
    camera = open_camera(source)
    assert isinstance(camera, SubprocessCamera)
    assert (camera.name, camera.clock) == (source, clock)


def test_the_path_of_a_recording_names_its_kind(tmp_path: Path) -> None:
    (tmp_path / "desk.mcap").write_bytes(b"")
    (tmp_path / "rgb.txt").write_bytes(b"")
    assert open_camera(str(tmp_path / "desk.mcap")).name == f"bag:{tmp_path}/desk.mcap"
    assert open_camera(str(tmp_path)).name == f"tum:{tmp_path}"
    with pytest.raises(InputError, match="needs a file: bag:FILE"):
        open_camera("bag:")


def test_a_camera_that_can_be_lost_is_made_to_reconnect(tmp_path: Path) -> None:
    recording, virtual = open_camera(f"tum:{tmp_path}"), open_camera("synthetic")
    assert make_reconnecting(recording) is recording
    assert make_reconnecting(virtual) is not virtual
    assert make_reconnecting(virtual).reconnects


def test_every_camera_is_registered_and_has_a_help_text() -> None:
    for name in CAMERA_USAGES:
        assert callable(CAMERAS[name])
    assert set(SENSORS) < set(CAMERAS)
