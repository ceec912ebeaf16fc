"""A recording that is cut off, by a kill or a full disk, holds whole frames."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.drivers.tum.read_recording import read_recording
from tests.forked_process import ForkedProcess
from tests.mount_namespace import AS_MAPPED_ROOT, need_mounts
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

RECORD_FOR_EVER = """
import sys
import weakref
from pathlib import Path
import numpy as np
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import UserFacingError
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder

noise = np.random.default_rng(0)
writer = FrameRecorder(TumFolder(Path(sys.argv[1])))
print("ready", flush=True)
try:
    for k in range(int(sys.argv[2])):
        color = noise.integers(0, 256, (48, 64, 3), dtype=np.uint8)
        depth = noise.integers(0, 65536, (48, 64), dtype=np.uint16)
        camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
        writer.write(RgbdFrame(k, 1000 + k / 30, 0.0, color, depth, 5000.0, camera))
    writer.close()
except UserFacingError as error:
    writer.close()
    print(writer.written, error)
"""


def test_a_recording_killed_at_any_moment_can_be_replayed(tmp_path: Path) -> None:
    for attempt in range(4):
        folder = tmp_path / str(attempt)
        command = [sys.executable, "-c", RECORD_FOR_EVER, str(folder), "1000000"]
        with ForkedProcess(command, stdout=subprocess.PIPE) as recording:
            assert recording.stdout is not None
            recording.stdout.readline()
            written, enough = folder / "associations.txt", 1000 * (attempt + 1)
            wait_until(lambda: written.stat().st_size >= enough)  # noqa: B023
            assert recording.poll() is None
            os.kill(recording.pid, signal.SIGKILL)
        frames = read_recording(folder)
        listed = (folder / "associations.txt").read_text()
        assert listed.endswith("\n")
        assert len(frames) == listed.count("\n") - 1 > 5


ON_A_SMALL_DISK = """
mount -t tmpfs -o size=300k,mode=777 small "$1" || exit
"$2" -c "$3" "$1/recording" 1000000
cp -r "$1/recording" "$4"
"""


def record_on_a_small_disk(tmp_path: Path, copy: Path) -> str:
    mount = tmp_path / "disk"
    mount.mkdir()
    script = ["sh", "-c", ON_A_SMALL_DISK, "sh", str(mount), sys.executable, RECORD_FOR_EVER]
    need_mounts(AS_MAPPED_ROOT)
    done = subprocess.run([*AS_MAPPED_ROOT, *script, str(copy)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.removeprefix("ready\n")


def test_a_full_disk_is_one_clear_error_and_the_written_part_replays(tmp_path: Path) -> None:
    printed = record_on_a_small_disk(tmp_path, tmp_path / "copy")
    written, message = printed.split(" ", 1)
    assert "recording: the disk is full (No space left on device); the " in message
    assert message.endswith("complete; free some space\n")
    assert len(read_recording(tmp_path / "copy")) == int(written) > 3
    assert not list((tmp_path / "copy").rglob(".*"))
