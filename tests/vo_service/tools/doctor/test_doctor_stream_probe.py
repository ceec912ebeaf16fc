"""Reading a camera for a while, whatever it does."""

from collections.abc import Iterator

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
from drivers.core.errors import CameraError, CameraLostError, InputError
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.doctor import stream_probe as watching
from vo_service.tools.doctor.stream_probe import probe_stream


class SampledCamera(RgbdCamera):
    """Delivers frames and raises errors in the order given; then it is silent for ever."""

    name = "scripted"
    clock = Clock.MONOTONIC

    def __init__(self, *script: RgbdFrame | Exception, reason: str = "") -> None:
        self._script: Iterator[RgbdFrame | Exception] = iter(script)
        self._reason = reason
        self.is_open = False

    def open(self) -> None:
        """See `RgbdCamera`."""
        self.is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`."""
        item = next(self._script, FrameTimeout())
        if isinstance(item, Exception):
            raise item
        return item

    def close(self) -> None:
        """See `RgbdCamera`."""
        self.is_open = False

    @property
    def counters(self) -> CameraCounters:
        """Something to be recognised by."""
        return CameraCounters(lost_packets=7)

    @property
    def status(self) -> CameraStatus:
        """See `RgbdCamera`."""
        return CameraStatus(CameraState.OPENING, self._reason)


class UnopenableCamera(SampledCamera):
    """Cannot be opened."""

    def open(self) -> None:
        """See `RgbdCamera`."""
        raise CameraError("in use; close the other program")


@pytest.fixture(autouse=True)
def little_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Silent cameras are given up at once."""
    for name in ("MAX_START_S", "MAX_PAUSE_S", "RECOVERY_TIMEOUT_S"):
        monkeypatch.setattr(watching, name, 0.05)


@pytest.fixture
def frame() -> RgbdFrame:
    """Any frame."""
    return render_corner(np.eye(4))


def test_frames_are_measured_and_kept(frame: RgbdFrame) -> None:
    kept: list[RgbdFrame] = []
    seen = probe_stream(SampledCamera(frame, frame, EndOfStream()), 5.0, kept.append)
    assert (len(seen.samples), kept) == (2, [frame, frame])
    assert seen.size == (frame.camera.width, frame.camera.height)
    assert seen.samples[0].stamp_s == frame.stamp_s
    assert (seen.error, seen.counters.lost_packets) == ("", 7)


def test_watching_ends_when_the_time_is_up(frame: RgbdFrame) -> None:
    seen = probe_stream(
        SampledCamera(*[frame] * 3, FrameTimeout(), *[frame] * 1000), 1e-9, lambda _: None
    )
    assert (len(seen.samples), seen.error) == (1, "")


def test_a_camera_that_cannot_be_opened_says_why() -> None:
    seen = probe_stream(UnopenableCamera(), 5.0, lambda _: None)
    assert (seen.samples, seen.error) == ((), "in use; close the other program")


def test_a_camera_that_is_lost_says_why(frame: RgbdFrame) -> None:
    camera = SampledCamera(frame, CameraLostError("unplugged; plug it in again"))
    seen = probe_stream(camera, 5.0, lambda _: None)
    assert (len(seen.samples), seen.error) == (1, "unplugged; plug it in again")
    assert not camera.is_open


def test_a_silent_camera_is_given_up_with_its_reason() -> None:
    camera = SampledCamera(reason="the driver hung while opening the camera")
    assert (
        probe_stream(camera, 5.0, lambda _: None).error
        == "the driver hung while opening the camera"
    )


def test_a_silent_camera_without_a_reason_is_given_up() -> None:
    assert probe_stream(SampledCamera(), 5.0, lambda _: None).error == "no frame within 0.05 s"


def test_what_the_user_gave_is_not_the_cameras_fault() -> None:
    camera = SampledCamera(InputError("desk: no such folder"))
    with pytest.raises(InputError, match="no such folder"):
        probe_stream(camera, 5.0, lambda _: None)
    assert not camera.is_open
