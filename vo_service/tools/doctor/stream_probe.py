"""Open a camera, read its frames for some seconds, and keep what can be measured of them."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.camera import CameraCounters, EndOfStream, FrameTimeout, RgbdCamera, RgbdFrame
from drivers.core.errors import InputError, UserFacingError

POLL_PERIOD_S = 0.1
# A driver's process on a slow disk may take long to begin; no pause afterwards may be that long.
MAX_START_S, MAX_PAUSE_S = 30.0, 5.0
# A camera that says why it sends nothing may still come round by itself within this.
RECOVERY_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class FrameSample:
    """What is kept of a frame; see `RgbdFrame`."""

    seq: int
    stamp_s: float
    receive_time_s: float
    device_stamp_s: float | None
    skew_s: float
    gravity_m_s2: tuple[float, float, float] | None


@dataclass(frozen=True)
class StreamSample:
    """What came.

    size           columns and rows of the images; None without a frame
    first_frame_s  from `open` to the first frame; None without one
    trouble        why nothing came, or why it stopped; "" where frames came to the end
    """

    samples: tuple[FrameSample, ...] = ()
    size: tuple[int, int] | None = None
    first_frame_s: float | None = None
    counters: CameraCounters = CameraCounters()  # noqa: RUF009 (frozen)
    intrinsics_source: str = ""
    error: str = ""


_log = logging.getLogger(__name__)


class _StreamStoppedError(Exception):
    """The camera has stopped, or never began; the text says why."""


def probe_stream(
    camera: RgbdCamera, seconds: float, on_frame: Callable[[RgbdFrame], None]
) -> StreamSample:
    """Open it, read for `seconds` after the first frame or to the end of a recording, close it.

    `keep` gets every frame. Raises InputError for what the user gave.
    """
    samples: list[FrameSample] = []
    size, trouble = None, ""
    begin_s = time.monotonic()
    try:
        camera.open()
        for frame in _read_frames(camera, seconds):
            samples.append(_make_sample(frame))
            size = (frame.camera.width, frame.camera.height)
            on_frame(frame)
    except (InputError, KeyboardInterrupt):
        raise
    except (UserFacingError, _StreamStoppedError) as error:
        trouble = str(error)
    finally:
        counters, intrinsics_source = camera.counters, camera.intrinsics_source
        camera.close()
    return StreamSample(
        samples=tuple(samples),
        size=size,
        first_frame_s=samples[0].receive_time_s - begin_s if samples else None,
        counters=counters,
        intrinsics_source=intrinsics_source,
        error=trouble,
    )


def _read_frames(camera: RgbdCamera, seconds: float) -> Iterator[RgbdFrame]:
    """Frames until the time is up. Raises _TroubleError when they do not come or stop coming."""
    silence = _FrameTimeout(camera)
    end_s = float("inf")
    while time.monotonic() < end_s:
        try:
            frame = camera.read(POLL_PERIOD_S)
        except FrameTimeout:
            silence.check()
            continue
        except EndOfStream:
            return
        silence.reset()
        end_s = min(end_s, time.monotonic() + seconds)
        yield frame


class _FrameTimeout:
    """How long nothing has come, and what the camera says about it."""

    def __init__(self, camera: RgbdCamera) -> None:
        self._camera = camera
        self._start(MAX_START_S)

    def reset(self) -> None:
        """A frame came."""
        self._start(MAX_PAUSE_S)

    def _start(self, max_wait_s: float) -> None:
        self._longest_s = max_wait_s
        self._end_s = time.monotonic() + max_wait_s
        self._reason = ""

    def check(self) -> None:
        """Nothing came. Raises _TroubleError if there is no hope."""
        condition = self._camera.status
        reason = condition.reason
        if reason and not self._reason:
            # What comes later, such as "not there", is but a consequence.
            self._reason = reason
            self._end_s = min(self._end_s, time.monotonic() + RECOVERY_TIMEOUT_S)
            _log.info("%s: %s", condition.state, reason)
        if time.monotonic() > self._end_s:
            raise _StreamStoppedError(self._reason or f"no frame within {self._longest_s:g} s")


def _make_sample(frame: RgbdFrame) -> FrameSample:
    return FrameSample(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        receive_time_s=frame.receive_time_s,
        device_stamp_s=frame.device_stamp_s,
        skew_s=frame.skew_s,
        gravity_m_s2=frame.gravity_m_s2,
    )
