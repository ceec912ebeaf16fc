"""``calibrate --timing``: from a shaken camera to two keys of its file, and what is refused."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import CAMERA_FILE_NAME, format_calibration, read_calibration
from tests.vo_service.cli.cli_runner import run_in_process
from tests.vo_service.tools.calibration.shaken_sequence import record_repeated, render_segment
from vo_service.tools.calibration.motion_segments import MotionSegment
from vo_service.tools.calibration.timing import TimingEstimate
from vo_service.tools.calibration.timing_cost import SensorTiming

pytestmark = pytest.mark.slow

Capture = pytest.CaptureFixture[str]
READOUT_S, LATE_S = 0.017, -0.004


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four times the same second; its stamps say nothing of the skew."""
    folder = tmp_path_factory.mktemp("shaken") / "hand"
    return record_repeated(folder, render_segment(READOUT_S, LATE_S), 4)


@pytest.fixture(autouse=True)
def working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_shaken_camera_gives_its_readout_and_its_offset(recording: Path, capfd: Capture) -> None:
    camera = replace(read_calibration(recording / CAMERA_FILE_NAME), depth_offset_s=0.002)
    Path("sensor.toml").write_text(f"# mine\n{format_calibration(camera)}")
    outcome = run_in_process(
        capfd, "calibrate", "--timing", recording, "--camera-file", "sensor.toml"
    )
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert "the 4 fastest segments of 32 frames, of 128 frames\n" in outcome.out
    assert "saved in sensor.toml; the one before is sensor.toml.bak\n" in outcome.out
    found = read_calibration(Path("sensor.toml"))
    np.testing.assert_allclose(found.readout_s, READOUT_S, atol=0.003)
    np.testing.assert_allclose(found.depth_offset_s, LATE_S, atol=0.002)
    assert replace(found, readout_s=0.0, depth_offset_s=0.002) == camera
    assert Path("sensor.toml").read_text().startswith("# mine\n")


def test_slow_motion_is_rejected_and_nothing_is_written(
    recording: Path, tmp_path: Path, capfd: Capture
) -> None:
    piece = render_segment(0.0, 0.0, frames=1) * 32
    still = [replace(frame, seq=n, stamp_s=n / 30) for n, frame in enumerate(piece)]
    folder = record_repeated(tmp_path / "still", still, 4)
    outcome = run_in_process(
        capfd, "calibrate", "--timing", folder, "--output", "new.toml", "--json"
    )
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("kinect-vo: error: nothing is saved: the camera moved too slowly")
    assert outcome.err.count("\n") == 1
    assert not Path("new.toml").exists()


def test_a_live_camera_is_observed_for_a_minute_and_only_json_is_printed(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capfd: Capture
) -> None:
    seen: list[MotionSegment] = []

    def measure(pieces: list[MotionSegment], tell: Callable[[str], None]) -> TimingEstimate:
        seen.extend(pieces)
        return TimingEstimate(SensorTiming(0.0203, -0.0012), SensorTiming(0.0004, 0.0003), 4)

    monkeypatch.setattr("vo_service.cli.calibrate_timing.estimate_timing", measure)
    # Two of the four pieces are seen within this time.
    monkeypatch.setattr("vo_service.tools.calibration.motion_segments.CAPTURE_DURATION_S", 2.4)
    file = Path("live.toml")
    file.write_text((recording / CAMERA_FILE_NAME).read_text())
    camera = ("--camera", f"tum:{recording}", "--camera-file", file)
    result = json.loads(run_in_process(capfd, "calibrate", "--timing", *camera, "--json").out)
    assert (result["camera_file"], result["kept"]) == ("live.toml", str(file.resolve()) + ".bak")
    assert (result["frames"], result["pieces"], len(seen)) == (64, 4, 2)
    assert result["readout_s"] == {"before": 0.0, "now": 0.0203, "sigma": 0.0004}
    assert result["depth_offset_s"] == {"before": 0.0, "now": -0.0012, "sigma": 0.0003}
    assert read_calibration(file).depth_offset_s == -0.0012


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
def test_a_mistake_is_one_line(mistake: str, capfd: Capture) -> None:
    arguments, message = MISTAKES[mistake]
    outcome = run_in_process(capfd, "calibrate", "--timing", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.count("\n") == 1
    assert message in outcome.err


def test_an_offset_that_the_stamps_may_contain_is_not_added(
    recording: Path, capfd: Capture
) -> None:
    camera = replace(read_calibration(recording / CAMERA_FILE_NAME), depth_offset_s=0.004)
    Path("sensor.toml").write_text(format_calibration(camera))
    outcome = run_in_process(capfd, "calibrate", "--timing", recording, "--output", "sensor.toml")
    assert outcome.code == 2
    assert "sensor.toml: depth_offset_s = 0.004 may be in the stamps of" in outcome.err
