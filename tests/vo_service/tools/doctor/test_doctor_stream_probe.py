"""Reading a camera for some seconds, with all its errors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraError, CameraLostError, InputError
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.doctor import stream_probe
from vo_service.tools.doctor.stream_probe import probe_stream


class SampledCamera(RgbdCamera):
    """Camera that delivers frames and raises errors in the given order, then sends nothing."""

    name = "scripted"
    clock = Clock.MONOTONIC

    def __init__(
        self,
        *script: RgbdFrame | Exception,
        reason: str = "",
        state: CameraState = CameraState.OPENING,
    ) -> None:
        self._script: Iterator[RgbdFrame | Exception] = iter(script)
        self._status = CameraStatus(state, reason)
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        item = next(self._script, FrameTimeout())
        if isinstance(item, Exception):
            raise item
        return item

    def close(self) -> None:
        self.is_open = False

    @property
    def counters(self) -> CameraCounters:
        """Counters with a known value."""
        return CameraCounters(lost_packets=7)

    @property
    def status(self) -> CameraStatus:
        return self._status


class UnopenableCamera(SampledCamera):
    """Camera that cannot be opened."""

    def open(self) -> None:
        raise CameraError("in use; close the other program")


@pytest.fixture(autouse=True)
def short_timeouts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the timeouts, so that silent cameras fail at once."""
    for name in ("MAX_START_S", "MAX_PAUSE_S", "RECOVERY_TIMEOUT_S"):
        monkeypatch.setattr(stream_probe, name, 0.05)


@pytest.fixture
def frame() -> RgbdFrame:
    """Any frame."""
    return render_corner(np.eye(4))


def test_frames_are_measured_and_passed_on(frame: RgbdFrame) -> None:
    received: list[RgbdFrame] = []
    sample = probe_stream(SampledCamera(frame, frame, EndOfStream()), 5.0, received.append)
    assert (len(sample.frames), received) == (2, [frame, frame])
    assert sample.frames[0].stamp_s == frame.stamp_s
    assert (sample.error, sample.counters.lost_packets) == ("", 7)


def test_frames_are_checked_for_plausibility(frame: RgbdFrame) -> None:
    far = replace(frame, depth_raw=np.full((48, 64), 9000, np.uint16), depth_factor=1000.0)
    sample = probe_stream(SampledCamera(far, EndOfStream()), 5.0, lambda _: None)
    assert "depth_factor = 1000 (the camera) gives a median depth of 9 m" in sample.implausible


def test_reading_ends_when_the_time_is_up(frame: RgbdFrame) -> None:
    sample = probe_stream(
        SampledCamera(*[frame] * 3, FrameTimeout(), *[frame] * 1000), 1e-9, lambda _: None
    )
    assert (len(sample.frames), sample.error) == (1, "")


def test_a_camera_that_prepares_has_the_time_to_start(
    frame: RgbdFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_probe, "MAX_START_S", 100.0)
    monkeypatch.setattr(stream_probe, "RECOVERY_TIMEOUT_S", -1.0)
    script = FrameTimeout(), FrameTimeout(), frame, EndOfStream()
    camera = SampledCamera(*script, reason="preparing its room", state=CameraState.STARTING)
    sample = probe_stream(camera, 5.0, lambda _: None)
    assert (len(sample.frames), sample.error) == (1, "")


def test_the_error_of_opening_and_of_a_lost_camera_is_reported(frame: RgbdFrame) -> None:
    sample = probe_stream(UnopenableCamera(), 5.0, lambda _: None)
    assert (sample.frames, sample.error) == ((), "in use; close the other program")
    camera = SampledCamera(frame, CameraLostError("unplugged; plug it in again"))
    sample = probe_stream(camera, 5.0, lambda _: None)
    assert (len(sample.frames), sample.error) == (1, "unplugged; plug it in again")
    assert not camera.is_open


@pytest.mark.parametrize(
    ("reason", "error"),
    [
        ("the driver hung while opening the camera", "the driver hung while opening the camera"),
        ("", "no frame within 0.05 s"),
    ],
)
def test_a_silent_camera_fails_with_its_reason(reason: str, error: str) -> None:
    assert probe_stream(SampledCamera(reason=reason), 5.0, lambda _: None).error == error


def test_invalid_input_is_raised() -> None:
    camera = SampledCamera(InputError("desk: no such folder"))
    with pytest.raises(InputError, match="no such folder"):
        probe_stream(camera, 5.0, lambda _: None)
    assert not camera.is_open
