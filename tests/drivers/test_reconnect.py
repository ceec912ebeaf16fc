"""A lost camera is opened again, at once or ever more rarely."""

from contextlib import suppress
from itertools import pairwise

import pytest

from drivers.camera import CameraState, CameraStatus, EndOfStream, FrameTimeout
from drivers.core import CameraError, CameraLostError, CameraNotFoundError, InputError
from drivers.reconnect import MAX_RETRY_S, ConnectionPhase, ReconnectingCamera
from tests.vo_service.fakes import Delay, FakeClock, ScriptedCamera, make_frame

LOST = CameraLostError("unplugged; plug it in again")
MISSING = CameraNotFoundError("no Kinect found; plug one in")
BUSY = CameraError("held by another process; end that")


def read_seqs(camera: ReconnectingCamera, reads: int) -> list[int | None]:
    """Open the camera and read; None stands for a read without a frame."""
    camera.open()
    seqs: list[int | None] = []
    for _ in range(reads):
        try:
            seqs.append(camera.read(10.0).seq)
        except FrameTimeout:
            seqs.append(None)
    return seqs


def make_camera(scripted: ScriptedCamera, clock: FakeClock, **options: float) -> ReconnectingCamera:
    return ReconnectingCamera(scripted, now_s=clock, **options)  # type: ignore[arg-type]


def test_a_lost_camera_is_opened_again() -> None:
    clock = FakeClock()
    scripted = ScriptedCamera([make_frame(1), LOST], MISSING, [make_frame(7)], clock=clock)
    assert read_seqs(make_camera(scripted, clock), 4) == [1, None, None, 7]
    assert (scripted.opened, scripted.closed) == (3, 2)


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ([make_frame(1), LOST], CameraStatus(CameraState.LOST, str(LOST))),
        (MISSING, CameraStatus(CameraState.ABSENT, str(MISSING))),
        (BUSY, CameraStatus(CameraState.OPENING, str(BUSY))),
    ],
)
def test_the_status_says_why_there_is_no_frame(part: object, expected: CameraStatus) -> None:
    clock = FakeClock()
    scripted = ScriptedCamera(part, [make_frame(2)], clock=clock)  # type: ignore[arg-type]
    camera = make_camera(scripted, clock)
    camera.open()
    while not camera.loss:
        with suppress(FrameTimeout):
            camera.read(10.0)
    assert camera.status == expected
    assert camera.read(10.0).seq == 2
    assert camera.status == CameraStatus(CameraState.STREAMING)


def test_retry_delays_grow_up_to_a_limit_and_start_again_with_a_frame() -> None:
    clock, opened_s = FakeClock(), []
    scripted = ScriptedCamera(*[MISSING] * 6, [make_frame(1), LOST], MISSING, clock=clock)

    def note_time(phase: ConnectionPhase) -> None:
        if phase is ConnectionPhase.OPENING:
            opened_s.append(clock.now_s)

    camera = ReconnectingCamera(scripted, on_phase=note_time, now_s=clock)
    read_seqs(camera, 8)
    delays_s = [after - before for before, after in pairwise(opened_s)]
    assert delays_s == pytest.approx([0.2, 0.4, 0.8, MAX_RETRY_S, MAX_RETRY_S, MAX_RETRY_S, 0.2])


def test_a_device_that_is_plugged_in_is_opened_at_once() -> None:
    class NoticingCamera(ScriptedCamera):
        def wait_for_reconnect(self, timeout_s: float) -> None:
            clock.now_s += 0.01

    clock = FakeClock()
    begin_s = clock.now_s
    scripted = NoticingCamera(*[MISSING] * 9, [make_frame(1)], clock=clock)
    assert read_seqs(make_camera(scripted, clock), 9)[-1] == 1
    assert clock.now_s - begin_s < 0.2


def test_a_camera_without_a_first_frame_is_opened_again() -> None:
    clock = FakeClock()
    silent = [Delay(0.4, FrameTimeout()) for _ in range(3)]
    scripted = ScriptedCamera(silent, [make_frame(1)], clock=clock)
    camera = make_camera(scripted, clock, first_frame_s=1.0)
    assert read_seqs(camera, 3) == [None] * 3
    assert "sent no frame within 1 s" in camera.status.reason
    assert camera.read(10.0).seq == 1


def test_counts_accumulate_over_openings() -> None:
    clock = FakeClock()
    scripted = ScriptedCamera(
        [make_frame(1), make_frame(2), LOST], MISSING, [make_frame(7), LOST], [make_frame(9)],
        clock=clock,
    )  # fmt: skip
    camera = make_camera(scripted, clock)
    read_seqs(camera, 7)
    assert camera.counters.delivered == 4


def test_an_error_that_waiting_does_not_help_and_the_end_are_raised() -> None:
    with pytest.raises(InputError, match="no such folder"):
        ReconnectingCamera(ScriptedCamera(InputError("DESK: no such folder"))).open()
    camera = ReconnectingCamera(ScriptedCamera([]))
    camera.open()
    with pytest.raises(EndOfStream):
        camera.read(1.0)
