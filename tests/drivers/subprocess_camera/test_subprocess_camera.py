"""Live cameras in a process of their own: whatever they do there, the service goes on."""

import logging
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import CameraState, CameraStatus, FrameTimeout, RgbdFrame
from drivers.core import CameraLostError, InputError
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.drivers.subprocess_camera.conftest import LONG_TIMEOUTS, MakeSubprocessCamera
from tests.drivers.subprocess_camera.scripted_cameras import (
    LOST_PACKETS,
    FileScriptedCamera,
    SingleFrameCamera,
    WarningCamera,
    is_intact,
)
from tests.resource_leaks import child_pids, resources_in_use
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

STREAMING = CameraStatus(CameraState.STREAMING)
SHORT = Timeouts(opening_s=1.0, heartbeat_s=1.0, closing_s=1.0, first_frame_s=0.5)


def frames(camera: SubprocessCamera, count: int) -> list[RgbdFrame]:
    return [camera.read(100.0) for _ in range(count)]


def wait_for_reason(camera: SubprocessCamera, words: str) -> CameraStatus:
    wait_until(lambda: words in camera.status.reason, f"{words!r}: {camera.status}")
    return camera.status


def assert_works_again(camera: SubprocessCamera, script: Path) -> None:
    """The cause goes away: frames come, whole ones, and the condition says so."""
    script.write_text("")
    wait_until(lambda: camera.status == STREAMING, f"to stream: {camera.status}")
    assert all(is_intact(frame) for frame in frames(camera, 5))


def test_open_returns_at_once_and_frames_follow_later(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    script.write_text("hang in open")
    with make_subprocess_camera(limits=SHORT) as camera:
        with pytest.raises(FrameTimeout):
            camera.read(0.0)
        assert camera.status.state is CameraState.OPENING
        assert_works_again(camera, script)


def test_an_unplugged_camera_is_absent_until_replugged(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    with make_subprocess_camera(limits=LONG_TIMEOUTS) as camera:
        before = frames(camera, 5)[-1]
        script.write_text("absent")
        missing = CameraStatus(CameraState.ABSENT, "no scripted camera found; plug one in")
        wait_until(lambda: camera.status == missing)
        assert_works_again(camera, script)
        after = camera.read(100.0)
    assert after.seq > before.seq
    assert after.stamp_s > before.stamp_s
    assert after.lost_packets == before.lost_packets  # one process, all the time


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("unplugged in read", CameraStatus(CameraState.LOST, "the scripted camera was unplugged")),
        (
            "busy",
            CameraStatus(
                CameraState.OPENING, "the scripted camera is held by another process; end that"
            ),
        ),
    ],
)
def test_the_status_is_that_of_the_camera(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, words: str, expected: CameraStatus
) -> None:
    with make_subprocess_camera() as camera:
        frames(camera, 1)
        script.write_text(words)
        wait_until(lambda: camera.status == expected, str(camera.status))
        assert_works_again(camera, script)


@pytest.mark.parametrize(
    ("words", "doing"),
    [
        ("hang in open", "opening the camera"),
        ("hang and talk in read", "reading frames"),
        ("hang with lock in read", "reading frames"),
        ("hang in close", "closing the camera"),
    ],
)
def test_a_hanging_driver_is_killed_without_a_grace_period_and_restarted(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, words: str, doing: str
) -> None:
    kind = SingleFrameCamera if "read" not in words else FileScriptedCamera
    limits = SHORT if "close" in words else replace(SHORT, closing_s=3600.0)
    with make_subprocess_camera(kind, limits=limits) as camera:
        first = camera.read(100.0)
        script.write_text(words)
        found = wait_for_reason(camera, f"the driver hung while {doing}: no answer for 1 s")
        assert found.state is (CameraState.OPENING if "open" in words else CameraState.LOST)
        script.write_text("")
        second = camera.read(100.0)
    assert second.lost_packets != first.lost_packets  # another process
    assert second.seq > first.seq
    assert second.stamp_s > first.stamp_s


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (
            "crash in read",
            "the driver crashed (signal 11, Segmentation fault); "
            "last line: libscripted: cutting a string",
        ),
        ("exit in read", "the driver ended (exit code 1); last line: libscripted: out of strings"),
        (
            "raise in read",
            "the driver ended (exit code 1); last line: ValueError: strings in a tangle",
        ),
    ],
)
def test_a_dead_driver_is_restarted(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, words: str, reason: str
) -> None:
    with make_subprocess_camera() as camera:
        frames(camera, 1)
        script.write_text(words)
        assert wait_for_reason(camera, reason) == CameraStatus(CameraState.LOST, reason)
        assert_works_again(camera, script)


def test_a_camera_that_opens_and_sends_nothing_counts_as_lost(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    script.write_text("silent in read")
    with make_subprocess_camera(limits=SHORT) as camera:
        assert wait_for_reason(camera, "sent no frame within 0.5 s").state is CameraState.LOST
        assert_works_again(camera, script)


def test_frame_counters_of_the_camera_reach_the_reader(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    complaint = CameraStatus(CameraState.STREAMING, "losing strings: 3 of 5 frames torn")
    with make_subprocess_camera(WarningCamera) as camera:
        frames(camera, 1)
        wait_until(lambda: camera.status == complaint)


def test_a_camera_without_frames_is_asked_for_the_reason(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    script.write_text("silent in read")
    complaint = CameraStatus(CameraState.LOST, "losing strings: 3 of 5 frames torn")
    with make_subprocess_camera(
        WarningCamera, limits=replace(LONG_TIMEOUTS, first_frame_s=0.2)
    ) as camera:
        wait_until(lambda: camera.status == complaint)


def test_permanent_errors_reach_the_reader(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    script.write_text("wrong")
    with make_subprocess_camera() as camera:
        for _ in range(2):
            with pytest.raises(InputError, match="no such file"):
                camera.read(100.0)
        wait_until(lambda: child_pids() == [])


def test_counts_continue_over_openings_and_processes(
    make_subprocess_camera: MakeSubprocessCamera, script: Path
) -> None:
    with make_subprocess_camera() as camera:
        frames(camera, 3)
        script.write_text("unplugged in read")
        wait_for_reason(camera, "unplugged")
        assert_works_again(camera, script)
        script.write_text("exit in read")
        wait_for_reason(camera, "exit code 1")
        assert_works_again(camera, script)
        wait_until(lambda: camera.counters.lost_packets >= 3 * LOST_PACKETS)
        assert camera.counters.delivered == 13
    assert camera.counters.lost_packets % LOST_PACKETS == 0


def test_in_realtime_frames_missed_by_a_late_reader_are_counted(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with make_subprocess_camera() as camera:
        first = camera.read(100.0)
        script.write_text("say in read")  # a line with every frame
        wait_until(lambda: caplog.text.count("2 strings left") > 20)
        seqs = [frame.seq for frame in frames(camera, 20)]
        gaps = seqs[-1] - first.seq - 20
        assert camera.counters.dropped >= gaps > 0


def test_a_process_that_fails_to_start_is_reported_and_retried(
    make_subprocess_camera: MakeSubprocessCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = resources_in_use()
    with monkeypatch.context() as patch:
        patch.setattr("sys.executable", "/nowhere/python")
        camera = make_subprocess_camera()
        camera.open()
        wait_for_reason(camera, "the driver cannot be started: No such file or directory")
    frames(camera, 1)
    camera.close()
    assert resources_in_use() <= before


def test_a_camera_that_is_not_open_is_lost(make_subprocess_camera: MakeSubprocessCamera) -> None:
    camera = make_subprocess_camera()
    camera.close()
    with pytest.raises(CameraLostError, match="scripted: not open; use `with`"):
        camera.read(1.0)


def test_numbers_and_stamps_increase_over_close_and_open(
    make_subprocess_camera: MakeSubprocessCamera,
) -> None:
    camera = make_subprocess_camera()
    last = (-1, -1.0)
    for _ in range(2):
        with camera:
            for frame in frames(camera, 10):
                assert (frame.seq, frame.stamp_s) > last
                assert frame.stamp_s > last[1]
                last = (frame.seq, frame.stamp_s)


def test_driver_logs_and_prints_reach_the_log(
    make_subprocess_camera: MakeSubprocessCamera, script: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    script.write_text("say in open")
    with make_subprocess_camera() as camera:
        camera.read(100.0)
        wait_until(lambda: "libscripted: mind the strings" in caplog.text)
    logged = {(record.name, record.levelname, record.getMessage()) for record in caplog.records}
    assert ("scripted", "WARNING", "2 strings left") in logged
    assert (
        "drivers.core.process.worker_process",
        "DEBUG",
        "driver: libscripted: mind the strings",
    ) in logged
