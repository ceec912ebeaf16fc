"""Sequences that benchmarks render once and store."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.rendered_sequences import (
    TIMINGS,
    VirtualRecording,
    is_complete,
    make_configs,
    render,
    render_all,
)
from drivers.camera import PinholeCamera
from drivers.core import InputError
from drivers.faulty_camera import Fault, FaultKind
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.tum.folder import open_tum_folder

pytestmark = pytest.mark.slow

TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)
CONFIG = SyntheticConfig(camera=TINY, duration_s=0.2, texel_m=0.05, motion=MotionKind.STILL)
FAULTY = replace(CONFIG, faults=(Fault(FaultKind.DROPPED, 2, 1),))


@pytest.fixture(scope="module")
def rendered_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence that was rendered after an interrupted rendering."""
    folder = tmp_path_factory.mktemp("rendered") / "room"
    (folder.with_name("room.part") / "rgb").mkdir(parents=True)
    render(folder, VirtualRecording(FAULTY))
    return folder


def test_a_sequence_is_complete_with_its_truth_and_its_faults(rendered_folder: Path) -> None:
    opened = open_tum_folder(rendered_folder, None)
    assert len(opened.frames.pairs) == 5
    assert opened.ground_truth is not None
    assert len(opened.ground_truth) == 6
    assert opened.calibration.readout_s == CONFIG.timing.readout_s
    assert not rendered_folder.with_name("room.part").exists()


def test_only_changed_sequences_are_rendered_again(
    rendered_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = rendered_folder.name
    assert render_all(rendered_folder.parent, {name: FAULTY}, 1) == {name: rendered_folder}
    assert capsys.readouterr().err == ""
    assert is_complete(rendered_folder, VirtualRecording(FAULTY))
    assert not is_complete(rendered_folder, VirtualRecording(CONFIG))


def test_a_folder_of_other_files_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="was not written by this program; name another folder"):
        render(tmp_path, VirtualRecording(CONFIG))
    assert (tmp_path / "thesis.txt").exists()


def track_of(folder: Path, seconds: int) -> Path:
    file = folder / "fr1_xyz-groundtruth.txt"
    file.write_text("".join(f"{stamp} 0 0 0 0 0 0 1\n" for stamp in range(seconds + 1)))
    return folder


def test_each_track_is_rendered_in_each_room_with_each_timing(tmp_path: Path) -> None:
    wanted = make_configs(track_of(tmp_path, 30), [11, 12], list(TIMINGS))
    assert len(wanted) == 8
    config = wanted["fr1_xyz-room12-rolling--12"]
    assert (config.seed, config.timing.readout_s, config.timing.skew_s) == (12, 0.02, -0.012)
    with pytest.raises(InputError, match="name a folder of TUM trajectories"):
        make_configs(tmp_path / "fr1", [11], ["ideal"])


def test_a_shorter_track_is_rendered_to_its_end(tmp_path: Path) -> None:
    def config(start_s: float) -> SyntheticConfig:
        return make_configs(track_of(tmp_path, 23), [11], ["ideal"], start_s, 10.0)[
            "fr1_xyz-room11-ideal"
        ]

    assert (config(4.0).track_start_s, config(4.0).duration_s) == (4.0, 10.0)
    assert config(20.0).duration_s == 3.0
    with pytest.raises(InputError, match="ends after 23 s; start earlier than at 25 s"):
        config(25.0)
