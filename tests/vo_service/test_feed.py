"""Frames from cameras that go away, fall silent and come back."""

import threading

import pytest

from drivers.camera import CameraState, Condition, NoFrameYet
from drivers.errors import CameraLostError, CameraNotFoundError, InputError
from tests.vo_service.fakes import After, Event, FakeClock, PatientStop, ScriptedCamera, frame
from vo_service import feed
from vo_service.feed import TICK_S, PersistentFeed, PlainFeed, SteadyFeed

LOST = CameraLostError("unplugged; plug it in again")
MISSING = CameraNotFoundError("no Kinect found; plug one in")


def seqs(stop: threading.Event, source: PlainFeed | PersistentFeed) -> list[int | None]:
    return [None if each is None else each.seq for each in source.frames(stop)]


def test_one_pass_gives_every_frame_and_ends() -> None:
    camera = ScriptedCamera([frame(1), frame(2), frame(3)])
    camera.open()
    plain = PlainFeed(camera)
    assert seqs(threading.Event(), plain) == [1, 2, 3]
    assert (plain.reason, plain.counters.delivered) == ("", 3)


def test_one_pass_lets_a_lost_camera_reach_the_caller() -> None:
    camera = ScriptedCamera([frame(1), LOST])
    camera.open()
    with pytest.raises(CameraLostError, match="unplugged"):
        seqs(threading.Event(), PlainFeed(camera))


class ClockStop(threading.Event):
    """Never set; whoever waits for it moves the clock."""

    def __init__(self, clock: FakeClock) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self._clock.now_s += max(0.0, timeout or 0.0)
        return False


def test_a_steady_pass_is_no_faster_than_the_recording_and_never_hurries_to_make_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = FakeClock(now_s=50.0)
    monkeypatch.setattr(feed, "time", clock)
    late = After(1.0, frame(2, stamp_s=7.2))
    camera = ScriptedCamera(
        [frame(0, 7.0), frame(1, 7.1), late, frame(3, 7.3), frame(4, 7.4)], clock=clock
    )
    camera.open()
    taken_s = [clock.now_s for _ in SteadyFeed(camera).frames(ClockStop(clock))]
    assert taken_s == pytest.approx([50.0, 50.1, 51.1, 51.2, 51.3])


def test_a_short_pause_is_no_reason_and_a_quiet_second_is(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()
    monkeypatch.setattr(feed, "time", clock)
    pauses = [After(0.4, NoFrameYet()) for _ in range(3)]
    camera = ScriptedCamera([frame(1), *pauses, After(0.1, frame(2))], clock=clock)
    camera.open()
    plain = PlainFeed(camera)
    reasons = [plain.reason for _ in plain.frames(threading.Event())]
    assert reasons == ["", "", "", "the camera is there but sends no frames", ""]


def test_a_camera_that_says_why_frames_are_missing_is_quoted_once_none_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = FakeClock()
    monkeypatch.setattr(feed, "time", clock)
    torn = Condition(CameraState.STREAMING, "losing USB packets: 30 of 30 frames torn")
    camera = ScriptedCamera([frame(1), *(After(0.4, torn) for _ in range(3))], clock=clock)
    camera.open()
    plain = PlainFeed(camera)
    assert [plain.reason for _ in plain.frames(threading.Event())] == ["", "", "", torn.reason]


def test_the_reason_is_the_cameras_condition_at_every_tick_until_a_frame_comes() -> None:
    opening, starting = Condition(CameraState.OPENING), Condition(CameraState.STARTING)
    missing = Condition(CameraState.ABSENT, "no Kinect found; plug one in")
    lost = Condition(CameraState.LOST, "unplugged")
    part: list[Event] = [opening, missing, starting, frame(1), lost, frame(2)]
    source = PersistentFeed(ScriptedCamera(part))
    reasons = [source.reason for _ in source.frames(PatientStop(1))]
    told = ["opening", "absent: no Kinect found; plug one in", "starting", "", "lost: unplugged"]
    assert reasons == [*told, "", "the recording has ended"]


def test_a_lost_camera_is_opened_again() -> None:
    camera = ScriptedCamera([frame(1), LOST], [frame(7)])
    assert seqs(PatientStop(2), PersistentFeed(camera)) == [1, None, 7, None]
    assert camera.opened == 2


def test_the_reason_is_what_the_camera_said_and_goes_when_frames_come() -> None:
    source = PersistentFeed(ScriptedCamera(MISSING, [frame(1), LOST]))
    reasons = [source.reason, *(source.reason for _ in source.frames(PatientStop(2)))]
    assert reasons == ["camera not opened yet", str(MISSING), "", str(LOST)]


def openings(camera: ScriptedCamera, ticks: int) -> list[int]:
    """How often the camera had been opened, at each turn of the loop."""
    return [camera.opened for _ in PersistentFeed(camera).frames(PatientStop(ticks))]


def test_retries_wait_longer_and_longer_up_to_a_limit() -> None:
    found = openings(ScriptedCamera(*[MISSING] * 9), ticks=19)
    assert found == [1] + [2] * 2 + [3] * 4 + [4] * 6 + [5] * 6


def test_a_camera_that_delivered_is_opened_again_quickly() -> None:
    camera = ScriptedCamera(MISSING, MISSING, [frame(1), LOST], MISSING)
    assert openings(camera, ticks=6) == [1] + [2] * 2 + [3] * 2 + [4] * 2


def test_while_it_waits_the_loop_gets_its_turns() -> None:
    stop = PatientStop(20)
    seqs(stop, PersistentFeed(ScriptedCamera(*[MISSING] * 9)))
    assert stop.waited_s == [TICK_S] * 20


def test_counts_add_up_over_all_openings() -> None:
    camera = ScriptedCamera([frame(1), frame(2), LOST], MISSING, [frame(7), LOST], [frame(9)])
    source = PersistentFeed(camera)
    seqs(PatientStop(5), source)
    assert source.counters.delivered == 4


def test_a_camera_that_goes_is_closed_before_it_is_opened_again() -> None:
    camera = ScriptedCamera(MISSING, [frame(1), LOST], [frame(2)])
    seqs(PatientStop(3), PersistentFeed(camera))
    assert camera.closed == camera.opened == 3


def test_after_its_end_a_recording_has_no_frames_but_the_loop_goes_on() -> None:
    source = PersistentFeed(ScriptedCamera([frame(1)]))
    stop = PatientStop(4)
    assert seqs(stop, source) == [1, None, None, None, None]
    assert source.reason == "the recording has ended"
    assert stop.waited_s == [TICK_S] * 4


def test_what_the_user_named_wrong_reaches_the_caller_and_the_camera_is_closed() -> None:
    camera = ScriptedCamera(InputError("DESK: no such folder"))
    with pytest.raises(InputError, match="no such folder"):
        seqs(PatientStop(3), PersistentFeed(camera))
    assert camera.closed == 1


@pytest.mark.parametrize("kind", [PlainFeed, PersistentFeed])
def test_a_stop_ends_it_at_the_next_frame(kind: type[PlainFeed] | type[PersistentFeed]) -> None:
    camera = ScriptedCamera([frame(1), frame(2), frame(3)])
    camera.open() if kind is PlainFeed else None
    stop = threading.Event()
    taken = []
    for each in kind(camera).frames(stop):
        taken.append(each)
        stop.set()
    assert len(taken) == 1


def test_a_stop_ends_it_within_a_tick_while_the_camera_is_silent() -> None:
    camera = ScriptedCamera([NoFrameYet()] * 10)
    stop = threading.Event()
    given = 0
    for _ in PersistentFeed(camera).frames(stop):
        given += 1
        stop.set()
    assert (given, camera.closed) == (1, 1)
