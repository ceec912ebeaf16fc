"""``calibrate --save-learned``: from what a service has learned to a camera file."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.calibration import TUM_CALIBRATIONS, format_calibration, read_calibration
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.learned_updates import LEARNED, SERIAL
from vo_service.sensor_memory import RememberedFocalLength, sensor_folder, write_remembered_sensor

CAMERA = replace(TUM_CALIBRATIONS["1"], readout_s=0.02)
OTHER = replace(LEARNED, serial="B2")


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The empty memory of this user's services; there is a camera file in the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    monkeypatch.setattr("vo_service.sensor_memory.SYSTEMD_STATE_FOLDERS", tmp_path / "var")
    Path("camera.toml").write_text(format_calibration(CAMERA))
    return sensor_folder(tmp_path / "state")


def test_the_learned_timing_is_written_with_its_sigmas(memory: Path, kinect_vo: KinectVo) -> None:
    write_remembered_sensor(memory, LEARNED)
    outcome = kinect_vo("calibrate", "--save-learned", "--camera-file", "camera.toml")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"serial: {SERIAL}\n" in outcome.out
    assert "20.0 ± 1.0 ms     30.5 ± 1.2 ms\n" in outcome.out
    assert outcome.out.endswith("saved in camera.toml; the one before is camera.toml.bak\n")
    assert read_calibration(Path("camera.toml")) == replace(
        CAMERA,
        readout_s=0.0305,
        readout_sigma_s=0.0012,
        depth_offset_s=-0.0027,
        depth_offset_sigma_s=0.0006,
    )


def test_a_sensor_is_chosen_by_its_serial_and_a_new_file_is_a_copy(
    memory: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    write_remembered_sensor(memory, LEARNED)
    write_remembered_sensor(sensor_folder(tmp_path / "var/kinect-vo-front"), OTHER)
    arguments = ("--serial", "B2", "--camera-file", "camera.toml", "--output", "new.toml")
    outcome = kinect_vo("calibrate", "--save-learned", *arguments, "--json")
    result = json.loads(outcome.out)
    assert (result["serial"], result["camera_file"], result["kept"]) == ("B2", "new.toml", None)
    assert result["readout_s"]["now"] == {"value_s": 0.0305, "sigma_s": 0.0012}
    assert read_calibration(Path("new.toml")).fx == CAMERA.fx
    assert read_calibration(Path("camera.toml")) == CAMERA


def test_fx_and_fy_are_multiplied_by_the_learned_factor(memory: Path, kinect_vo: KinectVo) -> None:
    focal_length = RememberedFocalLength(CAMERA.fx, 1.02, 0.006, -0.01)
    write_remembered_sensor(memory, replace(LEARNED, focal_length=focal_length))
    outcome = kinect_vo("calibrate", "--save-learned", *FILE)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"serial: {SERIAL}, factor on fx and fy: 1.02\n" in outcome.out
    saved = read_calibration(Path("camera.toml"))
    assert (saved.fx, saved.fy) == (round(1.02 * CAMERA.fx, 2), round(1.02 * CAMERA.fy, 2))
    assert (saved.cx, saved.distortion) == (CAMERA.cx, CAMERA.distortion)


def test_a_focal_length_learned_with_other_intrinsics_is_not_written(
    memory: Path, kinect_vo: KinectVo
) -> None:
    focal_length = RememberedFocalLength(525.0, 1.02, 0.006, -0.01)
    write_remembered_sensor(memory, replace(LEARNED, focal_length=focal_length))
    outcome = kinect_vo("calibrate", "--save-learned", *FILE)
    assert outcome.code == 0
    assert "fx and fy are unchanged: the focal length was learned with fx = 525.00" in outcome.err
    assert read_calibration(Path("camera.toml")).fx == CAMERA.fx


FILE = ["--camera-file", "camera.toml"]
MISTAKES = {
    "nothing learned": ([], FILE, "no service has learned a timing yet (searched: /"),
    "several": (
        [LEARNED, OTHER],
        FILE,
        f"several sensors are known; choose one with --serial: {SERIAL}, B2",
    ),
    "another": ([LEARNED], [*FILE, "--serial", "C3"], f"nothing is learned of it; known: {SERIAL}"),
    "no file": ([LEARNED], [], "--save-learned puts its result into a camera file: name it with"),
    "gone": ([LEARNED], ["--camera-file", "gone.toml"], "gone.toml: cannot be read"),
    "a camera": ([LEARNED], [*FILE, "--camera", "freenect"], "leave out FOLDER, --camera and"),
    "a board": ([LEARNED], [*FILE, "--square", "0.02"], "a board, which --save-learned does"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(mistake: str, memory: Path, kinect_vo: KinectVo) -> None:
    learned, arguments, message = MISTAKES[mistake]
    for timing in learned:
        write_remembered_sensor(memory, timing)
    assert_one_line(kinect_vo("calibrate", "--save-learned", *arguments), 2, message)
    assert read_calibration(Path("camera.toml")) == CAMERA


def test_a_damaged_file_is_a_warning(memory: Path, kinect_vo: KinectVo) -> None:
    write_remembered_sensor(memory, LEARNED)
    (memory / "B2.toml").write_text("nonsense")
    outcome = kinect_vo("calibrate", "--save-learned", *FILE)
    assert outcome.code == 0
    assert "B2.toml:1: not TOML" in outcome.err


def test_a_serial_alone_chooses_nothing(memory: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("calibrate", "--serial", SERIAL)
    assert "add --save-learned" in outcome.err
