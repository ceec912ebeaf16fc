"""``calibrate --timing``: from a shaken camera to the keys of its file, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.calibration import (
    CAMERA_FILE_NAME,
    KINECT_READOUT_S,
    CameraCalibration,
    format_calibration,
    read_calibration,
)
from drivers.camera import RgbdFrame
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.odometry.direct.rolling_shutter_views import add_noise, render_view
from tests.vo_service.odometry.direct.swinging_camera import SwingingCamera

pytestmark = pytest.mark.slow

READOUT_S, LATE_S = 0.017, -0.004


def record(folder: Path, is_moving: bool = True) -> Path:
    """A second of a shaken camera; neither its stamps nor its camera file tell the timing."""
    with FrameRecorder(TumFolder(folder)) as writer:
        for n in range(30):
            view = render_view(
                SwingingCamera(), n / 30 * is_moving, readout_s=READOUT_S, skew_s=LATE_S
            )
            writer.write(untimed(add_noise(view, n), n))
    file = folder / CAMERA_FILE_NAME
    camera = replace(read_calibration(file), readout_sigma_s=None, depth_offset_sigma_s=None)
    file.write_text(format_calibration(camera))
    return folder


def untimed(frame: RgbdFrame, seq: int) -> RgbdFrame:
    """The frame with a stamp at 30 Hz that tells nothing else."""
    return replace(frame, seq=seq, stamp_s=seq / 30, readout_s=0.0, skew_s=0.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A shaken camera."""
    return record(tmp_path_factory.mktemp("shaken") / "hand")


@pytest.fixture(autouse=True)
def working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write_camera(recording: Path, **timing: Any) -> CameraCalibration:
    """Write sensor.toml, with a comment and this timing; its contents."""
    camera = replace(read_calibration(recording / CAMERA_FILE_NAME), **timing)
    Path("sensor.toml").write_text(f"# mine\n{format_calibration(camera)}")
    return camera


def test_a_shaken_camera_gives_its_timing_with_sigmas(recording: Path, kinect_vo: KinectVo) -> None:
    camera = write_camera(recording, depth_offset_sigma_s=0.02)
    outcome = kinect_vo("calibrate", "--timing", recording, "--camera-file", "sensor.toml")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert outcome.out.startswith("frames: 30\n")
    assert "0.0 ± 30.0 ms" in outcome.out
    assert outcome.out.endswith("saved in sensor.toml; the one before is sensor.toml.bak\n")
    found = read_calibration(Path("sensor.toml"))
    assert found.readout_sigma_s is not None
    assert found.depth_offset_sigma_s is not None
    assert found.readout_sigma_s < 0.005
    assert found.depth_offset_sigma_s < 0.003
    assert abs(found.readout_s - READOUT_S) < 2 * found.readout_sigma_s
    assert abs(found.depth_offset_s - LATE_S) < 2 * found.depth_offset_sigma_s
    found = replace(found, readout_s=0.0, depth_offset_s=0.0)
    assert replace(found, readout_sigma_s=None, depth_offset_sigma_s=0.02) == camera
    assert Path("sensor.toml").read_text().startswith("# mine\n")


def test_the_recording_of_a_kinect_is_combined_with_the_usual_values(
    recording: Path, kinect_vo: KinectVo
) -> None:
    write_camera(
        recording, readout_s=KINECT_READOUT_S, readout_sigma_s=0.004, depth_offset_sigma_s=0.005
    )
    outcome = kinect_vo(
        "calibrate", "--timing", recording, "--camera-file", "sensor.toml", "--json"
    )
    readout = json.loads(outcome.out)["readout_s"]
    assert readout["before"] == {"value_s": KINECT_READOUT_S, "sigma_s": 0.004}
    assert readout["measured"]["value_s"] < readout["now"]["value_s"] < KINECT_READOUT_S
    assert readout["now"]["sigma_s"] < min(readout["measured"]["sigma_s"], 0.004)
    assert read_calibration(Path("sensor.toml")).readout_s == readout["now"]["value_s"]


def test_a_camera_at_rest_is_rejected_and_nothing_is_written(
    tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = record(tmp_path / "still", is_moving=False)
    text = (folder / CAMERA_FILE_NAME).read_text()
    outcome = kinect_vo("calibrate", "--timing", folder, "--json")
    assert_one_line(outcome, 1, "error: nothing is saved: the camera moved too slowly")
    assert "readout 0.0 ± 30.0 ms (known: 0.0 ± 30.0 ms)" in outcome.err
    assert (folder / CAMERA_FILE_NAME).read_text() == text


def test_a_live_camera_is_observed_for_a_minute_at_most(
    recording: Path, monkeypatch: pytest.MonkeyPatch, kinect_vo: KinectVo
) -> None:
    # 22 of the frames are seen within this time.
    monkeypatch.setattr("vo_service.cli.calibrate_timing.CAPTURE_DURATION_S", 0.71)
    write_camera(recording)
    camera = ("--camera", f"tum:{recording}", "--camera-file", "sensor.toml")
    result = json.loads(kinect_vo("calibrate", "--timing", *camera, "--json").out)
    assert (result["camera_file"], result["frames"]) == ("sensor.toml", 22)
    assert result["kept"] == str(Path("sensor.toml.bak").resolve())


MISTAKES = {
    "no source": ([], "name a FOLDER that was recorded, or a camera to shake: --camera"),
    "two sources": ([".", "--camera", "freenect"], "name a FOLDER that was recorded"),
    "no such folder": (["gone"], "there is no folder gone"),
    "no camera file": (["--camera", "freenect"], "name it with --camera-file, or make one first"),
    "virtual": (["--camera", "synthetic", "--camera-file", "camera.toml"], "its timing is known"),
    "of a board": ([".", "--square", "0.025"], "--square is about a board"),
    "no place": ([".", "--output", "gone/camera.toml"], "there is no folder gone"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(mistake: str, kinect_vo: KinectVo) -> None:
    arguments, message = MISTAKES[mistake]
    assert_one_line(kinect_vo("calibrate", "--timing", *arguments), 2, message)


def test_an_offset_that_the_stamps_may_contain_is_not_added(
    recording: Path, kinect_vo: KinectVo
) -> None:
    camera = replace(read_calibration(recording / CAMERA_FILE_NAME), depth_offset_s=0.004)
    Path("sensor.toml").write_text(format_calibration(camera))
    outcome = kinect_vo("calibrate", "--timing", recording, "--output", "sensor.toml")
    assert_one_line(outcome, 2, "sensor.toml: depth_offset_s = 0.004 may be in the stamps of")
