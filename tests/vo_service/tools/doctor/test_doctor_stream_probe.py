"""Reading a camera for some seconds, with all its errors."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import CameraState, CameraStatus, FrameTimeout, RgbdFrame
from drivers.core import CameraError, CameraLostError, InputError
from tests.vo_service.fakes import Delay, Event, FakeClock, ScriptedCamera
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.doctor import stream_probe
from vo_service.tools.doctor.stream_probe import StreamSample, probe_stream

FRAME = render_corner(np.eye(4))
Probe = Callable[[Sequence[Event] | Exception], StreamSample]


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Probe:
    """Read a camera with these events for five seconds, which pass only with its delays."""
    clock = FakeClock()
    monkeypatch.setattr(stream_probe, "time", clock)

    def read(events: Sequence[Event] | Exception) -> StreamSample:
        camera = ScriptedCamera(events, clock=clock)
        try:
            return probe_stream(camera, 5.0, lambda _: None)
        finally:
            assert camera.closed == 1

    return read


def test_frames_are_measured_and_passed_on() -> None:
    received: list[RgbdFrame] = []
    sample = probe_stream(ScriptedCamera([FRAME, FRAME]), 5.0, received.append)
    assert (len(sample.frames), received) == (2, [FRAME, FRAME])
    assert sample.frames[0].stamp_s == FRAME.stamp_s
    assert (sample.error, sample.counters.delivered) == ("", 2)


def test_frames_are_checked_for_plausibility(probe: Probe) -> None:
    far = replace(FRAME, depth_raw=np.full((48, 64), 9000, np.uint16), depth_factor=1000.0)
    implausible = probe([far]).implausible
    assert "depth_factor = 1000 (the camera) gives a median depth of 9 m" in implausible


def test_reading_ends_when_the_time_is_up(probe: Probe) -> None:
    sample = probe([FRAME, Delay(4.9, FRAME), Delay(0.2, FRAME), FRAME])
    assert (len(sample.frames), sample.error) == (3, "")


def test_a_camera_that_prepares_has_the_time_to_start(probe: Probe) -> None:
    preparing = CameraStatus(CameraState.STARTING, "preparing its room")
    sample = probe([preparing, Delay(29.0, FrameTimeout()), FRAME])
    assert (len(sample.frames), sample.error) == (1, "")


@pytest.mark.parametrize(
    ("events", "frames", "error"),
    [
        (CameraError("in use; close the other program"), 0, "in use; close the other program"),
        ([FRAME, CameraLostError("unplugged; plug it in")], 1, "unplugged; plug it in"),
        ([CameraStatus(CameraState.OPENING, "it hung"), Delay(2.1, FrameTimeout())], 0, "it hung"),
        ([Delay(31.0, FrameTimeout())], 0, "no frame within 30 s"),
        ([FRAME, Delay(5.1, FrameTimeout())], 1, "no frame within 5 s"),
    ],
)
def test_a_camera_that_fails_or_sends_nothing_is_reported(
    probe: Probe, events: Sequence[Event] | Exception, frames: int, error: str
) -> None:
    sample = probe(events)
    assert (len(sample.frames), sample.error) == (frames, error)


def test_invalid_input_is_raised(probe: Probe) -> None:
    with pytest.raises(InputError, match="no such folder"):
        probe([InputError("desk: no such folder")])
