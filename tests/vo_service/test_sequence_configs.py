"""The configurations that write the virtual Kinect's sequences."""

from pathlib import Path

import numpy as np
import pytest

from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.tum.folder import open_tum_folder
from tests.vo_service.cli.cli_runner import run_in_process
from vo_service.config import read_config

FOLDER = Path(__file__).parents[2] / "config" / "sequences"
MOTIONS = [MotionKind.HAND_HELD, MotionKind.FLOOR, MotionKind.ORBIT]
PAGE = FOLDER.parents[1] / "docs" / "guide" / "recording.md"
TINY = """
[synthetic.camera]
width = 64
height = 48
fx = 52.5
fy = 52.5
cx = 31.5
cy = 23.5
"""


@pytest.mark.parametrize("motion", MOTIONS)
def test_each_sequence_is_a_complete_kinect_with_its_motion(motion: MotionKind) -> None:
    config = read_config(FOLDER / f"{motion}.toml")
    assert config.camera.source == "synthetic"
    assert config.synthetic == SyntheticConfig(motion=motion, duration_s=20.0)


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda file: file.stem)
def test_all_sequences_are_finite_virtual_kinects_and_documented(file: Path) -> None:
    config = read_config(file)
    assert config.camera.source == "synthetic"
    assert not config.synthetic.loop
    assert config.synthetic.color == SyntheticConfig().color
    assert f"--config config/sequences/{file.name} recordings/synthetic-" in file.read_text()
    assert file.stem in PAGE.read_text()


@pytest.mark.parametrize(("name", "begin_s", "end_s"), [("dark", 8, 11), ("gap", 10, 11)])
def test_faults_are_in_the_middle_of_a_sequence(name: str, begin_s: float, end_s: float) -> None:
    config = read_config(FOLDER / f"{name}.toml").synthetic
    (fault,) = config.faults
    assert fault.first == begin_s * config.rate_hz
    assert fault.first + fault.count == end_s * config.rate_hz


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_each_sequence_is_recorded_with_its_camera_and_the_exact_ground_truth(
    motion: MotionKind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    text = (FOLDER / f"{motion}.toml").read_text().replace("20.0", "20.0\ntexel_m = 0.05")
    (tmp_path / "tiny.toml").write_text(text + TINY)
    folder = tmp_path / f"synthetic-{motion}"
    outcome = run_in_process(
        capfd, "record", "--config", tmp_path / "tiny.toml", "--seconds", "0.2", folder
    )
    assert (outcome.code, outcome.out) == (0, f"6 frames in {folder}\n")
    recorded = open_tum_folder(folder, None)
    assert (len(recorded.frames.pairs), recorded.calibration.width) == (6, 64)
    assert recorded.ground_truth is not None
    stamps_s = [pair.color.stamp_s for pair in recorded.frames.pairs]
    np.testing.assert_array_equal(recorded.ground_truth.stamps_s, stamps_s)
