"""Whatever becomes of the driver's process, it leaves nothing behind and no torn frame."""

import os
import random
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.camera import CameraState, PlaybackMode
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.drivers.subprocess_camera.conftest import LONG_TIMEOUTS, MakeSubprocessCamera
from tests.drivers.subprocess_camera.scripted_cameras import (
    OpeningMarkerCamera,
    SingleFrameCamera,
    is_intact,
    opening_marker,
)
from tests.resource_leaks import child_pids, resources_in_use
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

IMPATIENT, RETRYING = Timeouts(closing_s=0.2), Timeouts(initial_retry_s=0.0)


def kill(process: int) -> None:
    """Kill the driver and wait until it has been reaped."""
    os.kill(process, signal.SIGKILL)
    wait_until(lambda: process not in child_pids())


def test_many_unplugs_leak_nothing(make_subprocess_camera: MakeSubprocessCamera) -> None:
    before = resources_in_use()
    with make_subprocess_camera(SingleFrameCamera, limits=LONG_TIMEOUTS, period_s=0.0) as camera:
        plugged_in = [camera.read(100.0) for _ in range(40)]
    assert resources_in_use() <= before
    assert len({frame.lost_packets for frame in plugged_in}) == 1
    assert plugged_in[-1].device_stamp_s == plugged_in[1].device_stamp_s  # files open over there


def is_under_way(camera: SubprocessCamera, script: Path) -> bool:
    """Whether the driver does what the script says, or streams where that is empty."""
    if script.read_text():
        return opening_marker(script).exists()
    return camera.status.state is CameraState.STREAMING


@pytest.mark.parametrize("words", ["", "absent", "hang in open", "hang with lock in open"])
def test_closing_leaks_nothing_in_any_driver_state(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, words: str
) -> None:
    before = resources_in_use()
    script.write_text(words)
    with make_subprocess_camera(OpeningMarkerCamera, limits=IMPATIENT) as camera:
        wait_until(lambda: is_under_way(camera, script))
        camera.close()
        assert resources_in_use() <= before


def test_a_driver_killed_at_any_time_leaves_no_partial_frame_and_leaks_nothing(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    chance, before = random.Random(4), resources_in_use()
    stamps_s, seqs = [-1.0], [-1]
    with make_subprocess_camera(
        pace=PlaybackMode.LOCKSTEP, limits=RETRYING, period_s=0.0, size=(640, 480)
    ) as camera:
        for _ in range(4):
            until_s = time.monotonic() + 0.1 + 0.02 * chance.random()
            victim = 0
            while time.monotonic() < until_s or not victim:
                frame = camera.read(100.0)
                victim = frame.lost_packets
                assert is_intact(frame)
                stamps_s.append(frame.stamp_s)
                seqs.append(frame.seq)
            kill(victim)
        camera.read(100.0)
    assert resources_in_use() <= before
    assert all(a < b for a, b in pairwise(stamps_s))
    assert all(a < b for a, b in pairwise(seqs))
