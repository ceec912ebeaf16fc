"""Recordings in a process of their own: nothing is lost, and what goes wrong is an error."""

import time
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import CameraCounters, EndOfStream, PlaybackMode
from drivers.core import CameraError, CameraLostError, CameraNotFoundError, InputError
from drivers.subprocess_camera.messages import Timeouts
from tests.drivers.subprocess_camera.conftest import LONG_TIMEOUTS, MakeSubprocessCamera
from tests.drivers.subprocess_camera.scripted_cameras import (
    RecordedCamera,
    is_intact,
    make_pattern_frame,
)
from tests.resource_leaks import resources_in_use

pytestmark = pytest.mark.subprocess


def test_in_lockstep_every_frame_arrives_in_order_and_bit_for_bit(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    with make_subprocess_camera(RecordedCamera, pace=PlaybackMode.LOCKSTEP, count=100) as camera:
        for seq in range(100):
            if seq % 30 == 0:
                time.sleep(0.05)  # the camera waits for its reader, and nothing tells that it does
            asked_s = time.monotonic()
            frame, expected = camera.read(100.0), make_pattern_frame(seq, 100.0 + seq / 30.0)
            assert asked_s <= frame.receive_time_s <= time.monotonic()
            assert (frame.seq, frame.stamp_s) == (expected.seq, expected.stamp_s)
            assert np.array_equal(frame.color_bgr, expected.color_bgr)
            assert np.array_equal(frame.depth_raw, expected.depth_raw)
        for _ in range(2):
            with pytest.raises(EndOfStream):
                camera.read(100.0)
        assert camera.counters.delivered == 100
        assert camera.counters.dropped == 0


def test_an_open_recording_is_ready(make_subprocess_camera: MakeSubprocessCamera) -> None:
    with make_subprocess_camera(RecordedCamera, pace=PlaybackMode.LOCKSTEP, count=9) as camera:
        assert camera.frame_count == 9
        assert (camera.intrinsics_source, camera.ground_truth) == ("factory", None)


def test_the_clock_starts_with_the_first_read(make_subprocess_camera: MakeSubprocessCamera) -> None:
    with make_subprocess_camera(
        RecordedCamera, pace=PlaybackMode.REALTIME, count=50, period_s=0.4
    ) as camera:
        time.sleep(0.5)  # longer than a frame: the second would be due if it ran already
        assert camera.read(100.0).seq == 0


def test_reopening_restarts_the_recording_and_continues_the_count(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    camera = make_subprocess_camera(RecordedCamera, pace=PlaybackMode.LOCKSTEP, count=9)
    for opened in (1, 2):
        with camera:
            assert [camera.read(100.0).seq for _ in range(3)] == [0, 1, 2]
        assert camera.counters == CameraCounters(delivered=3 * opened, lost_packets=3 * opened)


@pytest.mark.parametrize(
    ("words", "kind", "message"),
    [
        ("wrong in open", InputError, "scripted.toml: no such file"),
        ("absent in open", CameraNotFoundError, "no scripted camera found; plug one in"),
        ("crash in open", CameraLostError, r"the driver crashed \(signal 11, Seg"),
        ("hang in open", CameraLostError, "the driver hung while opening the camera"),
    ],
)
def test_a_failed_open_reports_the_error_and_leaks_nothing(
    make_subprocess_camera: MakeSubprocessCamera,
    script: Path,
    words: str,
    kind: type[CameraError],
    message: str,
) -> None:
    before = resources_in_use()
    script.write_text(words)
    limits = Timeouts(opening_s=0.5) if "hang" in words else LONG_TIMEOUTS
    camera = make_subprocess_camera(
        RecordedCamera, pace=PlaybackMode.LOCKSTEP, limits=limits, count=9
    )
    with pytest.raises(kind, match=message):
        camera.open()
    assert resources_in_use() <= before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "crash in read",
            "crashed .* last line: libscripted: cutting a string; open the recording",
        ),
        ("unplugged in read", "the scripted camera was unplugged"),
    ],
)
def test_a_truncated_recording_is_not_restarted(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, words: str, message: str
) -> None:
    with make_subprocess_camera(RecordedCamera, pace=PlaybackMode.LOCKSTEP, count=1000) as camera:
        camera.read(100.0)
        script.write_text(words)
        with pytest.raises(CameraLostError, match=message):
            all(is_intact(camera.read(100.0)) for _ in range(1000))
