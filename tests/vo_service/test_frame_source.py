"""Frames from cameras that go away, fall silent and come back."""

import threading
from dataclasses import replace

import pytest

from drivers.camera import CameraState, CameraStatus, FrameTimeout
from drivers.core import CameraLostError, InputError
from tests.vo_service.fakes import Delay, Event, FakeClock, InstantStop, ScriptedCamera, make_frame
from vo_service import frame_source
from vo_service.frame_source import TICK_S, FrameSource, LiveSource, PacedSource

LOST = CameraLostError("unplugged; plug it in again")


def seqs(stop: threading.Event, source: FrameSource | LiveSource) -> list[int | None]:
    return [None if each is None else each.seq for each in source.frames(stop)]


def test_one_pass_gives_every_frame_and_ends() -> None:
    camera = ScriptedCamera([make_frame(1), make_frame(2), make_frame(3)])
    camera.open()
    plain = FrameSource(camera)
    assert seqs(threading.Event(), plain) == [1, 2, 3]
    assert (plain.reason, camera.counters.delivered) == ("", 3)


def test_one_pass_lets_a_lost_camera_reach_the_caller() -> None:
    camera = ScriptedCamera([make_frame(1), LOST])
    camera.open()
    with pytest.raises(CameraLostError, match="unplugged"):
        seqs(threading.Event(), FrameSource(camera))


def test_a_paced_pass_waits_until_each_frame_is_due() -> None:
    camera = ScriptedCamera([make_frame(0, 7.0), make_frame(1, 1007.0)])
    camera.open()
    stop = InstantStop(3)
    assert seqs(stop, PacedSource(camera)) == [0, 1]
    assert stop.waited_s == pytest.approx([0.0, 1000.0], abs=500.0)


def test_a_short_pause_has_no_reason_and_a_second_without_frames_has(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = FakeClock()
    monkeypatch.setattr(frame_source, "time", clock)
    pauses = [Delay(0.4, FrameTimeout()) for _ in range(3)]
    camera = ScriptedCamera([make_frame(1), *pauses, Delay(0.1, make_frame(2))], clock=clock)
    camera.open()
    plain = FrameSource(camera)
    reasons = [plain.reason for _ in plain.frames(threading.Event())]
    assert reasons == ["", "", "", "the camera is there but sends no frames", ""]


def test_the_cameras_reason_for_missing_frames_is_used_once_none_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = FakeClock()
    monkeypatch.setattr(frame_source, "time", clock)
    torn = CameraStatus(CameraState.STREAMING, "losing USB packets: 30 of 30 frames torn")
    camera = ScriptedCamera([make_frame(1), *(Delay(0.4, torn) for _ in range(3))], clock=clock)
    camera.open()
    plain = FrameSource(camera)
    assert [plain.reason for _ in plain.frames(threading.Event())] == ["", "", "", torn.reason]


def test_the_reason_is_the_camera_status_until_a_frame_comes() -> None:
    opening, starting = CameraStatus(CameraState.OPENING), CameraStatus(CameraState.STARTING)
    missing = CameraStatus(CameraState.ABSENT, "no Kinect found; plug one in")
    lost = CameraStatus(CameraState.LOST, "unplugged")
    part: list[Event] = [opening, missing, starting, make_frame(1), lost, make_frame(2)]
    source = LiveSource(ScriptedCamera(part))
    reasons = [source.reason for _ in source.frames(InstantStop(1))]
    expected = [
        "opening",
        "absent: no Kinect found; plug one in",
        "starting",
        "",
        "lost: unplugged",
    ]
    assert reasons == [*expected, "", "the recording has ended"]


def test_each_frame_is_prepared() -> None:
    source = LiveSource(
        ScriptedCamera([make_frame(0), make_frame(1)]), lambda frame: replace(frame, serial="A1")
    )
    stop = InstantStop(1)
    frames = [frame for frame in source.frames(stop) if frame is not None]
    assert [(frame.seq, frame.serial) for frame in frames] == [(0, "A1"), (1, "A1")]


def test_after_the_end_of_a_recording_the_loop_continues_without_frames() -> None:
    source = LiveSource(ScriptedCamera([make_frame(1)]))
    stop = InstantStop(4)
    assert seqs(stop, source) == [1, None, None, None, None]
    assert source.reason == "the recording has ended"
    assert stop.waited_s == [TICK_S] * 4


def test_an_input_error_reaches_the_caller_and_the_camera_is_closed() -> None:
    camera = ScriptedCamera(InputError("DESK: no such folder"))
    with pytest.raises(InputError, match="no such folder"):
        seqs(InstantStop(3), LiveSource(camera))
    assert camera.closed == 1


@pytest.mark.parametrize("kind", [FrameSource, LiveSource])
def test_a_stop_ends_the_source_at_the_next_frame(
    kind: type[FrameSource] | type[LiveSource],
) -> None:
    camera = ScriptedCamera([make_frame(1), make_frame(2), make_frame(3)])
    camera.open() if kind is FrameSource else None
    stop = threading.Event()
    taken = []
    for each in kind(camera).frames(stop):
        taken.append(each)
        stop.set()
    assert len(taken) == 1


def test_a_stop_ends_the_source_within_a_tick_while_the_camera_is_silent() -> None:
    camera = ScriptedCamera([FrameTimeout()] * 10)
    stop = threading.Event()
    given = 0
    for _ in LiveSource(camera).frames(stop):
        given += 1
        stop.set()
    assert (given, camera.closed) == (1, 1)
