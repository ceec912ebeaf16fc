"""Open a camera in a subprocess, read frames for some seconds, and keep their measurements."""

import logging
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np

from drivers.camera import (
    CameraCounters,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
    new_images,
)
from drivers.core import InputError, UserFacingError
from drivers.plausibility import PlausibilityCheck
from vo_service.leveling.floor_plane import FloorDetector, FloorPlane

POLL_PERIOD_S = 0.1
# A driver's process may start slowly on a slow disk; later pauses must be shorter.
MAX_START_S, MAX_PAUSE_S = 30.0, 5.0
# A camera that reports why it sends nothing may still recover within this time.
RECOVERY_TIMEOUT_S = 2.0
# The floor is looked for in every n-th frame. Without an accelerometer the camera may look down by
# any of these angles.
FLOOR_STRIDE = 10
FLOOR_PITCHES_RAD = np.radians(np.arange(-10.0, 65.0, 5.0))
MAX_FLOOR_TILT_RAD = np.radians(5.0)


@dataclass(frozen=True)
class StreamSample:
    """Frames and errors of a camera.

    Attributes:
        frames: The frames, without their images.
        floors: The floor, where it is in view, of every `FLOOR_STRIDE`-th frame.
        first_frame_s: Time from `open` to the first frame; None without a frame.
        counters: The camera's counters at the end.
        intrinsics_source: Where the intrinsics come from.
        implausible: What is implausible of the intrinsics and the depth; "" if nothing.
        error: Why no frame came, or why frames stopped; "" if they came to the end.
    """

    frames: tuple[RgbdFrame, ...] = ()
    floors: tuple[FloorPlane, ...] = ()
    first_frame_s: float | None = None
    counters: CameraCounters = CameraCounters()  # noqa: RUF009 (frozen)
    intrinsics_source: str = ""
    implausible: str = ""
    error: str = ""


_log = logging.getLogger(__name__)


class _StreamStoppedError(Exception):
    """The camera sends no frames; the text gives the reason."""


def probe_stream(
    camera: RgbdCamera, seconds: float, on_frame: Callable[[RgbdFrame], None]
) -> StreamSample:
    """Open a camera, read frames and close it.

    Args:
        seconds: Time to read after the first frame; a recording may end earlier.

    Raises:
        InputError: The user's input is invalid.
    """
    frames: list[RgbdFrame] = []
    floors: list[FloorPlane] = []
    no_color, no_depth = new_images(0, 0)
    error_text = ""
    plausibility = PlausibilityCheck(camera)
    begin_s = time.monotonic()
    try:
        camera.open()
        for frame in _read_frames(camera, seconds):
            frames.append(replace(frame, color_bgr=no_color, depth_raw=no_depth))
            if frame.seq % FLOOR_STRIDE == 0 and (floor := find_floor(frame)):
                floors.append(floor)
            plausibility.add(frame)
            on_frame(frame)
    except (InputError, KeyboardInterrupt):
        raise
    except (UserFacingError, _StreamStoppedError) as error:
        error_text = str(error)
    finally:
        counters, intrinsics_source = camera.counters, camera.intrinsics_source
        camera.close()
    return StreamSample(
        frames=tuple(frames),
        floors=tuple(floors),
        first_frame_s=frames[0].receive_time_s - begin_s if frames else None,
        counters=counters,
        intrinsics_source=intrinsics_source,
        implausible=plausibility.warning,
        error=error_text,
    )


def _read_frames(camera: RgbdCamera, seconds: float) -> Iterator[RgbdFrame]:
    """Yield frames until the time is up. Raises _StreamStoppedError if no frames arrive."""
    reason, max_wait_s, end_s = "", MAX_START_S, float("inf")
    timeout_s = time.monotonic() + max_wait_s
    while time.monotonic() < end_s:
        try:
            frame = camera.read(POLL_PERIOD_S)
        except FrameTimeout:
            status = camera.status
            if status.reason and not status.is_preparing and not reason:
                # The first reason is the cause; later ones are its consequences.
                reason = status.reason
                timeout_s = min(timeout_s, time.monotonic() + RECOVERY_TIMEOUT_S)
                _log.info("%s: %s", status.state, reason)
            if time.monotonic() > timeout_s:
                raise _StreamStoppedError(reason or f"no frame within {max_wait_s:g} s") from None
            continue
        except EndOfStream:
            return
        reason, max_wait_s = "", MAX_PAUSE_S
        timeout_s = time.monotonic() + max_wait_s
        end_s = min(end_s, time.monotonic() + seconds)
        yield frame


def find_floor(frame: RgbdFrame) -> FloorPlane | None:
    """Find the floor in view, by gravity or by the largest plane that may be one."""
    if frame.gravity_m_s2 is not None:
        gravity_m_s2 = np.array(frame.gravity_m_s2)
        directions = [-gravity_m_s2 / np.linalg.norm(gravity_m_s2)]
    else:
        directions = [np.array([0.0, -np.cos(a), -np.sin(a)]) for a in FLOOR_PITCHES_RAD]
    detector = FloorDetector(frame.camera)
    found = [detector.find(frame, up, MAX_FLOOR_TILT_RAD) for up in directions]
    return max(filter(None, found), key=lambda floor: floor.readings, default=None)


T = TypeVar("T")


def call_in_subprocess(function: Callable[[], T], timeout_s: float) -> T:
    """Return the result of a picklable function.

    Raises:
        UserFacingError: The function raised it, crashed, or was killed after `timeout_s`.
    """
    command = [sys.executable, "-P", "-m", "vo_service.tools.doctor.stream_probe"]
    try:
        process = subprocess.run(
            command,
            input=pickle.dumps(function),
            capture_output=True,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UserFacingError(f"no answer within {timeout_s:g} s") from error
    if process.returncode < 0:
        raise UserFacingError(f"crashed with {signal.Signals(-process.returncode).name}")
    if process.returncode > 0 or not process.stdout:
        last_line = process.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise UserFacingError(f"failed: {''.join(last_line)}")
    result = pickle.loads(process.stdout)
    if isinstance(result, UserFacingError):
        raise result
    return cast("T", result)


def _main() -> None:
    """Run the function in the subprocess."""
    output = os.dup(1)
    os.dup2(2, 1)  # prints of native libraries must not mix with the result
    function: Callable[[], object] = pickle.load(sys.stdin.buffer)
    result: object
    try:
        result = function()
    except UserFacingError as error:
        result = error
    with os.fdopen(output, "wb") as file:
        pickle.dump(result, file)


if __name__ == "__main__":
    _main()
