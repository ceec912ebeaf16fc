"""The camera contract: what every backend delivers and how it says that it cannot.

A backend is one folder beside this file with one class derived from `RgbdCamera`.
"""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.config import required_field
from drivers.core.errors import CameraError
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from drivers.sensor_config import Led


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of an undistorted image, in pixels; the centre of the first pixel is (0, 0)."""

    width: int = required_field("columns of the image", minimum=1)
    height: int = required_field("rows of the image", minimum=1)
    fx: float = required_field("horizontal focal length, pixels", exclusive_minimum=0.0)
    fy: float = required_field("vertical focal length, pixels", exclusive_minimum=0.0)
    cx: float = required_field("column of the principal point, pixels")
    cy: float = required_field("row of the principal point, pixels")

    @property
    def K(self) -> Array:
        """3x3 intrinsics matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class RgbdFrame:
    """One instant of the camera: color and depth never travel apart.

    Both images are undistorted and share `camera`; depth is registered to color.
    The arrays are read-only by agreement: several readers share them.

    seq             number of this frame at its source, from 0; a gap means frames not delivered
    stamp_s         instant of the color image's middle row, on the clock named by the camera
    receive_time_s       CLOCK_MONOTONIC when the whole frame was in the host's hands
    color_bgr      (height, width, 3) uint8, OpenCV's channel order
    depth_raw       (height, width) uint16 as the sensor gave it, 0 = no reading
    depth_factor    value of `depth_raw` per metre
    camera          intrinsics of both images
    device_stamp_s  the device's own clock, where it has one
    skew_s          instant of depth minus instant of color
    lost_packets    packets lost since the frame before
    gravity_m_s2    gravity in camera axes (x right, y down, z forward), where an accelerometer
                    tells it
    readout_s       rolling shutter: seconds from the first row to the last of both images; their
                    instants are of the middle row. 0 = global shutter, or not known
    """

    seq: int
    stamp_s: float
    receive_time_s: float
    color_bgr: NDArray[np.uint8]
    depth_raw: NDArray[np.uint16]
    depth_factor: float
    camera: PinholeCamera
    device_stamp_s: float | None = None
    skew_s: float = 0.0
    lost_packets: int = 0
    gravity_m_s2: tuple[float, float, float] | None = None
    readout_s: float = 0.0

    @cached_property
    def depth_m(self) -> NDArray[np.float32]:
        """(height, width) float32 metres; 0 = no reading, never NaN."""
        return self.depth_raw * np.float32(1.0 / self.depth_factor)

    @cached_property
    def gray(self) -> NDArray[np.uint8]:
        """(height, width) uint8 brightness."""
        gray: NDArray[np.uint8] = cv2.cvtColor(self.color_bgr, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
        return gray


class Clock(StrEnum):
    """The clock that a camera's stamps are on."""

    MONOTONIC = "monotonic"  # this host's CLOCK_MONOTONIC
    RECORDED = "recorded"  # the recording's own time


class PlaybackMode(StrEnum):
    """How a recorded or computed source delivers."""

    LOCKSTEP = "lockstep"  # every frame, as fast as the reader takes them: repeatable
    REALTIME = "realtime"  # on the recording's own clock; frames not taken in time are dropped


class CameraState(StrEnum):
    """Where a camera is on its way from nothing to frames."""

    ABSENT = "absent"  # not there
    OPENING = "opening"  # there, being opened
    STARTING = "starting"  # open, no frame yet
    STREAMING = "streaming"
    LOST = "lost"  # was streaming; unplugged, stalled or crashed


@dataclass(frozen=True)
class CameraStatus:
    """How a camera is; the reason is why it sends no frames, or fewer than it should, else ""."""

    state: CameraState
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else str(self.state)


@dataclass(frozen=True)
class CameraCounters:
    """Totals since `open`: what did not reach the reader, and why."""

    delivered: int = 0
    dropped: int = 0  # whole frames that a newer one replaced before they were read
    skipped: int = 0  # frames that could not be read (a broken file, a torn frame)
    lost_packets: int = 0

    def __add__(self, other: Self) -> Self:
        return type(self)(
            delivered=self.delivered + other.delivered,
            dropped=self.dropped + other.dropped,
            skipped=self.skipped + other.skipped,
            lost_packets=self.lost_packets + other.lost_packets,
        )


class EndOfStream(Exception):  # noqa: N818 (like StopIteration: not an error)
    """The source has delivered its last frame."""


class FrameTimeout(Exception):  # noqa: N818 (a time-out that the reader expects)
    """No frame came within the time given; the camera may still be healthy."""


class RgbdCamera(ABC):
    """A source of `RgbdFrame`. Use as a context manager; one reader at a time.

    `open` may be called again after `close` (a camera that came back).
    """

    name: str  # for people: "tum:DIR", "synthetic"
    clock: Clock

    def prepare(self) -> None:  # noqa: B027 (most cameras have nothing to prepare)
        """Begin what takes long before the first frame, if anything does. Returns at once.

        May be called before the first `open`, which raises what goes wrong.
        """

    @abstractmethod
    def open(self) -> None:
        """Start delivering.

        Raises InputError if what the user named is wrong (a missing folder, a bad camera file),
        CameraError if the camera is not there or refuses now.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame: the next in order (lockstep) or the newest one not yet read.

        Raises NoFrameYet after `timeout_s`, EndOfStream after the last frame, CameraLostError when
        the camera has gone (close it, then open it again).
        """

    @abstractmethod
    def close(self) -> None:
        """Stop and release everything. Safe to call twice, and after a failed `open`."""

    @property
    @abstractmethod
    def counters(self) -> CameraCounters:
        """What was delivered, dropped, skipped and lost since `open`."""

    @property
    def status(self) -> CameraStatus:
        """How it is now. A camera whose `open` returns only once it can deliver need not say."""
        return CameraStatus(CameraState.STREAMING)

    @property
    def intrinsics_source(self) -> str:
        """Where the intrinsics come from: "camera file FILE", "factory", "default"; "" = exact."""
        return ""

    def wait_for_reconnect(self, timeout_s: float) -> None:
        """Wait before the next `open`; return early when the device seems to be back."""
        time.sleep(timeout_s)

    @property
    def has_motor(self) -> bool:
        """Whether there is a motor that tilts it, and a light."""
        return False

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Begin to tilt the head against the horizon: up is positive, +-31 degrees at most.

        May be called from any thread. It lasts: whenever the camera is opened again, it is done
        again. Raises CameraError without a motor, or if it cannot be done now: it is done then as
        soon as it can be.
        """
        raise CameraError(f"{self.name}: it has no motor")

    def set_led(self, led: Led) -> None:
        """Switch the light. Lasts, and raises CameraError, as `set_tilt_deg`."""
        raise CameraError(f"{self.name}: it has no light")

    @property
    def frame_count(self) -> int | None:
        """How many frames the source holds, where that is known: for progress."""
        return None

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses of the color camera, where the source knows them."""
        return None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
