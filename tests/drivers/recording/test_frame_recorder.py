"""What a recorder does whatever it writes into: a folder or an MCAP file."""

import dataclasses
import logging
import signal
import subprocess
import sys
import weakref
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.core import UserFacingError
from drivers.core.geometry import Trajectory
from drivers.playback.camera import RecordingCamera
from drivers.recording import frame_recorder
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.drivers.conftest import make_frame
from tests.drivers.tum.read_recording import assert_same, read_recording
from tests.forked_process import ForkedProcess
from tests.full_disk import limit_file_size

MakeRecorder = Callable[..., FrameRecorder[Any]]
# What may wait for the disk, and the frame that the writer has.
MAX_ALIVE = {"folder": 4 + 2, "mcap": 30 + 2}


@pytest.fixture(params=["folder", "mcap"])
def kind(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def make_recorder(kind: str, tmp_path: Path) -> MakeRecorder:
    """A lossless recorder."""

    def make(truth: Trajectory | None = None) -> FrameRecorder[Any]:
        if kind == "folder":
            return FrameRecorder(TumFolder(tmp_path / "r", ground_truth=truth))
        return FrameRecorder(McapRecordingFile(tmp_path / "r.mcap", is_raw=True), truth)

    return make


def test_a_recording_replays_the_same_frames_to_the_last_bit(make_recorder: MakeRecorder) -> None:
    gravity = (0.12345678901234567, 9.8, -0.3)
    frames = [
        make_frame(
            k, stamp_s=12345.678901234567 + k / 30, skew_s=0.01 - k / 3000, gravity_m_s2=gravity
        )
        for k in range(8)
    ]
    with make_recorder() as recorder:
        for frame in frames:
            recorder.write(frame)
    assert recorder.written == 8
    assert_same(read_recording(recorder.path), frames)


def test_ground_truth_is_kept(make_recorder: MakeRecorder) -> None:
    T = np.stack([np.eye(4)] * 2)
    T[1, :3, 3] = [1.0, -2.0, 0.5]
    truth = Trajectory(np.array([999.25, 1000.5]), T)
    with make_recorder(truth) as recorder:
        recorder.write(make_frame(0))
    with RecordingCamera(recorder.path) as camera:
        read = camera.ground_truth
    assert read is not None
    np.testing.assert_array_equal(read.stamps_s, truth.stamps_s)
    np.testing.assert_allclose(read.T_world_camera, T)


@pytest.mark.parametrize("stamp_s", [1000.0, 1000.0000001, 999.0])
def test_a_stamp_that_does_not_increase_is_skipped_and_reported(
    make_recorder: MakeRecorder, stamp_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), make_recorder() as recorder:
        for frame in (make_frame(0), make_frame(1, stamp_s=stamp_s), make_frame(2)):
            recorder.write(frame)
    assert (recorder.written, recorder.skipped) == (2, 1)
    assert "frame 1 is not recorded: its stamp does not rise" in caplog.text
    assert_same(read_recording(recorder.path), [make_frame(0), make_frame(2)])


def test_a_change_of_the_camera_is_rejected(make_recorder: MakeRecorder) -> None:
    with make_recorder() as recorder:
        recorder.write(make_frame(0))
        with pytest.raises(UserFacingError, match="the camera changed during recording"):
            recorder.write(dataclasses.replace(make_frame(1), depth_factor=1000.0))
        with pytest.raises(UserFacingError, match=r"readout 0\.03 s"):
            recorder.write(make_frame(2, readout_s=0.03))
    assert len(read_recording(recorder.path)) == 1


def test_a_full_disk_leaves_what_was_written_and_is_one_error(
    make_recorder: MakeRecorder, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_recorder, "FLUSH_PERIOD_S", 0.0)
    recorder = make_recorder()
    with limit_file_size(8_000 if kind == "folder" else 200_000):
        colors = (np.full((48, 64, 3), k % 256, np.uint8) for k in range(1000))
        frames = (make_frame(k, color_bgr=color) for k, color in enumerate(colors))
        with pytest.raises(UserFacingError, match=r"the disk is full \(File too large\); the "):
            deque(map(recorder.write, frames), maxlen=0)
        with pytest.raises(UserFacingError, match="the disk is full"):
            recorder.write(make_frame(1000))
        recorder.close()
        recorder.close()
    read = read_recording(recorder.path)
    assert len(read) == recorder.written > 3
    assert read[-1].color_bgr[0, 0, 0] == (len(read) - 1) % 256


def test_memory_does_not_grow_with_the_recording(make_recorder: MakeRecorder, kind: str) -> None:
    images = []
    with make_recorder() as recorder:
        for seq in range(60):
            frame = make_frame(seq)
            images.append(weakref.ref(frame.color_bgr))
            recorder.write(frame)
            alive = [image for image in images if image() is not None]
            assert len(alive) <= MAX_ALIVE[kind]
    assert recorder.written == 60


RECORD_FOR_EVER = """
import sys
from itertools import count
from pathlib import Path
import numpy as np
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder

noise = np.random.default_rng(0)
camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
path = Path(sys.argv[1])
recorder = FrameRecorder(McapRecordingFile(path) if path.suffix else TumFolder(path))
for k in count():
    color = noise.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    depth = noise.integers(0, 65536, (48, 64), dtype=np.uint16)
    recorder.write(RgbdFrame(k, 1000 + k / 30, 0.0, color, depth, 1000.0, camera))
    print(recorder.written, flush=True)
"""


@pytest.mark.subprocess
@pytest.mark.parametrize(("name", "frames"), [("r", 7), ("r", 40), ("r.mcap", 500)])
def test_a_recording_killed_at_any_moment_can_be_replayed(
    tmp_path: Path, name: str, frames: int
) -> None:
    command = [sys.executable, "-c", RECORD_FOR_EVER, str(tmp_path / name)]
    with ForkedProcess(command, stdout=subprocess.PIPE, text=True) as recording:
        assert recording.stdout is not None
        while int(recording.stdout.readline()) < frames:
            pass
        recording.send_signal(signal.SIGKILL)
        recording.stdout.read()
    stamps_s = [frame.stamp_s for frame in read_recording(tmp_path / name)]
    assert len(stamps_s) > frames / 5
    assert stamps_s == [1000 + k / 30 for k in range(len(stamps_s))]
