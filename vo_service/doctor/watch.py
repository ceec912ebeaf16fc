"""Open a camera, read its frames for some seconds, and keep what can be measured of them."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.camera import CameraCounters, EndOfStream, NoFrameYet, RgbdCamera, RgbdFrame
from drivers.errors import InputError, UserFacingError

TICK_S = 0.1
# A driver's process on a slow disk may take long to begin; no pause afterwards may be that long.
LONGEST_START_S, LONGEST_PAUSE_S = 30.0, 5.0
# A camera that says why it sends nothing may still come round by itself within this.
SECOND_CHANCE_S = 2.0


@dataclass(frozen=True)
class Sample:
    """What is kept of a frame; see `RgbdFrame`."""

    seq: int
    stamp_s: float
    arrival_s: float
    device_stamp_s: float | None
    skew_s: float
    gravity_m_s2: tuple[float, float, float] | None


@dataclass(frozen=True)
class Watched:
    """What came.

    size           columns and rows of the images; None without a frame
    first_frame_s  from `open` to the first frame; None without one
    trouble        why nothing came, or why it stopped; "" where frames came to the end
    """

    samples: tuple[Sample, ...] = ()
    size: tuple[int, int] | None = None
    first_frame_s: float | None = None
    counters: CameraCounters = CameraCounters()  # noqa: RUF009 (frozen)
    intrinsics_source: str = ""
    trouble: str = ""


_log = logging.getLogger(__name__)


class _TroubleError(Exception):
    """The camera has stopped, or never began; the text says why."""


def watch(camera: RgbdCamera, seconds: float, keep: Callable[[RgbdFrame], None]) -> Watched:
    """Open it, read for `seconds` after the first frame or to the end of a recording, close it.

    `keep` gets every frame. Raises InputError for what the user gave.
    """
    samples: list[Sample] = []
    size, trouble = None, ""
    begin_s = time.monotonic()
    try:
        camera.open()
        for frame in _frames(camera, seconds):
            samples.append(_sample(frame))
            size = (frame.camera.width, frame.camera.height)
            keep(frame)
    except (InputError, KeyboardInterrupt):
        raise
    except (UserFacingError, _TroubleError) as error:
        trouble = str(error)
    finally:
        counters, intrinsics_source = camera.counters, camera.intrinsics_source
        camera.close()
    return Watched(
        samples=tuple(samples),
        size=size,
        first_frame_s=samples[0].arrival_s - begin_s if samples else None,
        counters=counters,
        intrinsics_source=intrinsics_source,
        trouble=trouble,
    )


def _frames(camera: RgbdCamera, seconds: float) -> Iterator[RgbdFrame]:
    """Frames until the time is up. Raises _TroubleError when they do not come or stop coming."""
    silence = _Silence(camera)
    end_s = float("inf")
    while time.monotonic() < end_s:
        try:
            frame = camera.read(TICK_S)
        except NoFrameYet:
            silence.endure()
            continue
        except EndOfStream:
            return
        silence.end()
        end_s = min(end_s, time.monotonic() + seconds)
        yield frame


class _Silence:
    """How long nothing has come, and what the camera says about it."""

    def __init__(self, camera: RgbdCamera) -> None:
        self._camera = camera
        self._begin(LONGEST_START_S)

    def end(self) -> None:
        """A frame came."""
        self._begin(LONGEST_PAUSE_S)

    def _begin(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._end_s = time.monotonic() + longest_s
        self._reason = ""

    def endure(self) -> None:
        """Nothing came. Raises _TroubleError if there is no hope."""
        condition = self._camera.condition
        reason = condition.reason
        if reason and not self._reason:
            # What comes later, such as "not there", is but a consequence.
            self._reason = reason
            self._end_s = min(self._end_s, time.monotonic() + SECOND_CHANCE_S)
            _log.info("%s: %s", condition.state, reason)
        if time.monotonic() > self._end_s:
            raise _TroubleError(self._reason or f"no frame within {self._longest_s:g} s")


def _sample(frame: RgbdFrame) -> Sample:
    return Sample(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        arrival_s=frame.arrival_s,
        device_stamp_s=frame.device_stamp_s,
        skew_s=frame.skew_s,
        gravity_m_s2=frame.gravity_m_s2,
    )
