"""The camera contract: the frames that every backend delivers, its states and its errors.

A backend is one folder beside this file with one class derived from `RgbdCamera`.
"""

import logging
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray

from drivers.core import CameraError
from drivers.core.config import Field
from drivers.core.geometry import Array, Trajectory


class Led(StrEnum):
    """A state of the Kinect's LED."""

    OFF = "off"
    GREEN = "green"
    RED = "red"
    YELLOW = "yellow"
    BLINK_GREEN = "blink-green"
    BLINK_RED_YELLOW = "blink-red-yellow"


@dataclass(frozen=True)
class SensorConfig:
    """Settings of a real sensor, applied whenever it is opened."""

    auto_exposure: Annotated[bool, "false keeps the current exposure"] = True
    auto_white_balance: Annotated[bool, "false keeps the current white balance"] = True
    mirror: Annotated[bool, "swap left and right, for a camera that looks into a mirror"] = False
    led: Annotated[Led, Field("LED while the sensor is open", is_reloadable=True)] = Led.GREEN
    tilt_deg: Annotated[
        float | None,
        Field(
            "tilt of the head against the horizon; unset = unchanged",
            minimum=-31.0,
            maximum=31.0,
            is_reloadable=True,
        ),
    ] = None


def is_serial(text: str) -> bool:
    """Whether a device's text is a serial number: some sensors report only zeros."""
    return bool(text.strip("0"))


# Iteration over a camera logs after this time why no frame arrives.
NO_FRAME_WARNING_S = 1.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of an undistorted image, in pixels; the center of the first pixel is (0, 0)."""

    width: Annotated[int, Field("columns of the image", minimum=1)]
    height: Annotated[int, Field("rows of the image", minimum=1)]
    fx: Annotated[float, Field("horizontal focal length, pixels", exclusive_minimum=0.0)]
    fy: Annotated[float, Field("vertical focal length, pixels", exclusive_minimum=0.0)]
    cx: Annotated[float, "column of the principal point, pixels"]
    cy: Annotated[float, "row of the principal point, pixels"]

    @property
    def K(self) -> Array:
        """The 3x3 intrinsics matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


class TimingSource(StrEnum):
    """The origin of a sensor's timing."""

    CAMERA_FILE = "camera file"
    MEMORY = "memory"  # learned at an earlier run, see `SensorMemory`
    SENSOR = "usual for the sensor"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class TimingPrior:
    """How well the timing of a frame is known.

    Attributes:
        depth_offset_s: Part of the frame's `skew_s` that is not in its stamps.
        readout_sigma_s: Standard deviation of the frame's `readout_s`.
        depth_offset_sigma_s: Standard deviation of `depth_offset_s`.
        source: Where the values come from.
    """

    depth_offset_s: float
    readout_sigma_s: float
    depth_offset_sigma_s: float
    source: TimingSource


@dataclass(frozen=True)
class FocalPrior:
    """What was learned of a camera's focal length at an earlier run.

    Attributes:
        scale: Ratio to that of the frame.
        sigma: Standard deviation of `scale`.
    """

    scale: float
    sigma: float


@dataclass(frozen=True)
class PosePrior:
    """What else than images tells of the camera's motion since the last frame with a pose.

    Information matrices are 6x6 of `T_last_camera`, translation (m), then rotation (rad), as a
    small motion in this camera's axes.

    Attributes:
        T_last_camera: 4x4 predicted pose of the camera in that of the last frame.
        information: Of the prediction, floor included.
        floor_information: Of the part that a floor tells, whose error does not grow with the way.
        source: What tells all of the motion, such as "wheel odometry"; "" if only a part is told.
    """

    T_last_camera: Array
    information: Array
    floor_information: Array
    source: str = ""


@dataclass(frozen=True)
class AccelerometerReading:
    """One reading of an accelerometer.

    Attributes:
        stamp_s: Time of the reading, on the camera's clock.
        acceleration_m_s2: Specific force in camera axes (x right, y down, z forward): at rest it
            points up, against gravity.
    """

    stamp_s: float
    acceleration_m_s2: tuple[float, float, float]


MAX_ACCELEROMETER_READINGS = 16  # in one frame


class NewReadings:
    """Takes each reading of an accelerometer once, though successive frames share readings."""

    def __init__(self) -> None:
        self._last_stamp_s = -math.inf

    def take(self, readings: tuple[AccelerometerReading, ...]) -> list[AccelerometerReading]:
        """Return the readings since the last call, in their order."""
        if readings and readings[-1].stamp_s < self._last_stamp_s:  # the recording starts again
            self._last_stamp_s = -math.inf
        new = [each for each in readings if each.stamp_s > self._last_stamp_s]
        if new:
            self._last_stamp_s = new[-1].stamp_s
        return new


# The two images of a frame are at most this far apart.
MAX_PAIR_SKEW_US = 20_000
# Some programs store it for no reading.
MAX_DEPTH_VALUE = 65535


@dataclass(frozen=True)
class RgbdFrame:
    """A color image and the depth image registered to it.

    Both images are undistorted and share `camera`. Readers must not write to the arrays, which
    several readers share.

    Attributes:
        seq: Number of this frame at its source, from 0; a gap means frames not delivered.
        stamp_s: Capture time of the color image's middle row, on the camera's `clock`.
        receive_time_s: CLOCK_MONOTONIC when the host had received the whole frame.
        color_bgr: (height, width, 3) uint8, OpenCV's channel order.
        depth_raw: (height, width) uint16 as the sensor gave it, 0 = no reading. The value 65535,
            which is no reading either, becomes 0.
        depth_factor: Value of `depth_raw` per meter.
        camera: Intrinsics of both images.
        device_stamp_s: Stamp on the device's own clock, if it has one.
        skew_s: Capture time of depth minus capture time of color.
        lost_packets: Packets lost since the previous frame.
        gravity_m_s2: Gravity in camera axes (x right, y down, z forward), if an accelerometer
            measures it: a mean without motion.
        accelerometer: The newest readings at most `MAX_ACCELEROMETER_READINGS`, oldest first, up to
            this frame. The next frames have them too, because frames may be dropped.
        readout_s: Rolling shutter: seconds from the first row to the last of both images. 0 =
            global shutter, or unknown.
        timing_prior: How well `readout_s` and `skew_s` are known; None = exactly.
        serial: Serial number of the sensor; "" if unknown, or a recording.
        focal_prior: What is known of the focal length beside `camera`; None = nothing.
        accelerometer_bias_m_s2: (3,) bias of the accelerometer that an earlier run has learned, in
            camera axes; None = unknown.
        pose_prior: What else tells of the camera's motion; None = nothing.
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
    accelerometer: tuple[AccelerometerReading, ...] = ()
    readout_s: float = 0.0
    timing_prior: TimingPrior | None = None
    serial: str = ""
    focal_prior: FocalPrior | None = None
    accelerometer_bias_m_s2: tuple[float, float, float] | None = None
    pose_prior: PosePrior | None = None

    def __post_init__(self) -> None:
        # The maximum takes a third of the time of a comparison of all pixels.
        if self.depth_raw.max(initial=0) == MAX_DEPTH_VALUE:
            depth_raw = np.where(self.depth_raw == MAX_DEPTH_VALUE, np.uint16(0), self.depth_raw)
            object.__setattr__(self, "depth_raw", depth_raw)

    def restamped(self, stamp_s: float) -> Self:
        """Return the frame with another stamp, and its readings moved by the same time."""
        shift_s = stamp_s - self.stamp_s
        readings = [replace(each, stamp_s=each.stamp_s + shift_s) for each in self.accelerometer]
        return replace(self, stamp_s=stamp_s, accelerometer=tuple(readings))

    @cached_property
    def depth_m(self) -> NDArray[np.float32]:
        """Depth in meters, (height, width) float32; 0 = no reading, never NaN."""
        return self.depth_raw * np.float32(1.0 / self.depth_factor)

    @cached_property
    def gray(self) -> NDArray[np.uint8]:
        """Brightness, (height, width) uint8."""
        import cv2  # here, because programs without frames need this module, but not OpenCV

        gray: NDArray[np.uint8] = cv2.cvtColor(self.color_bgr, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
        return gray


# Color (height, width, 3) uint8 BGR, and depth (height, width) uint16.
ImageArrays = tuple[NDArray[np.uint8], NDArray[np.uint16]]


def new_images(width: int, height: int) -> ImageArrays:
    """Make arrays for the images of a frame."""
    return np.empty((height, width, 3), np.uint8), np.empty((height, width), np.uint16)


class Clock(StrEnum):
    """The clock of a camera's stamps."""

    MONOTONIC = "monotonic"  # this host's CLOCK_MONOTONIC
    RECORDED = "recorded"  # the recording's own time


class PlaybackMode(StrEnum):
    """The timing of frames from a recorded or computed source."""

    LOCKSTEP = "lockstep"  # every frame, as fast as the reader reads: repeatable
    REALTIME = "realtime"  # on the recording's own clock; frames not read in time are dropped


class CameraState(StrEnum):
    """The state of a camera."""

    ABSENT = "absent"  # not connected
    OPENING = "opening"  # connected, being opened
    STARTING = "starting"  # open, no frame yet
    STREAMING = "streaming"
    LOST = "lost"  # was streaming; unplugged, stalled or crashed


@dataclass(frozen=True)
class CameraStatus:
    """A camera's state, and the reason why it sends no or too few frames ("" if none)."""

    state: CameraState
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else str(self.state)

    @property
    def is_preparing(self) -> bool:
        """Whether the camera is well, and the reason is the work before its first frame."""
        return self.state is CameraState.STARTING and self.reason != ""

    @property
    def no_frame_reason(self) -> str:
        """Why no frame arrives, when none has arrived for some time; never empty."""
        if self.state is CameraState.STREAMING:
            return self.reason or "the camera is there but sends no frames"
        return str(self)


@dataclass(frozen=True)
class CameraCounters:
    """Totals since the camera was made."""

    delivered: int = 0
    dropped: int = 0  # whole frames that a newer one replaced before they were read
    skipped: int = 0  # unreadable frames (a broken file, an incomplete image)
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

    def __str__(self) -> str:
        return "the last frame has been delivered"


class FrameTimeout(Exception):  # noqa: N818 (a time-out that the reader expects)
    """No frame arrived within the timeout; the camera may still be healthy."""

    def __str__(self) -> str:
        return "no frame arrived within the timeout"


class RgbdCamera(ABC):
    """A source of `RgbdFrame`. Use as a context manager and iterate over it; one reader at a time.

    `open` may be called again after `close`, for example to reconnect.
    """

    name: str  # for messages: "tum:DIR", "synthetic"
    clock: Clock
    # Is never lost, or opens itself again after a loss: `read` then only times out.
    reconnects = False
    # Makes the arrays of width and height in which a camera may put the images of the next frame.
    make_images: Callable[[int, int], ImageArrays] = staticmethod(new_images)

    def prepare(self) -> None:  # noqa: B027 (most cameras have nothing to prepare)
        """Start long preparations for the first frame in the background. Returns at once.

        May be called before the first `open`, which raises the errors of the preparations.
        """

    @abstractmethod
    def open(self) -> None:
        """Start delivering frames.

        Raises:
            InputError: The user's input is wrong (a missing folder, a bad camera file).
            CameraError: The camera is not connected or does not start now.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame: the next in order (lockstep) or the newest one not yet read.

        Raises:
            FrameTimeout: No frame arrived within `timeout_s`.
            EndOfStream: The source has delivered its last frame.
            CameraLostError: The camera is lost; close it, then open it again.
        """

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield each frame that `read` returns, until the end of the source.

        Waits without limit for a live camera that sends nothing; a warning in the log says why.
        The camera must be open.

        Raises:
            CameraLostError: The camera is lost; close it, then open it again.
        """
        warned_reason = ""
        while True:
            try:
                frame = self.read(NO_FRAME_WARNING_S)
            except EndOfStream:
                return
            except FrameTimeout:
                reason = self.status.no_frame_reason
                if reason != warned_reason:
                    _log.warning("%s: waiting for a frame: %s", self.name, reason)
                warned_reason = reason
            else:
                warned_reason = ""
                yield frame

    @abstractmethod
    def close(self) -> None:
        """Stop and release everything. Safe to call twice, and after a failed `open`."""

    @property
    @abstractmethod
    def counters(self) -> CameraCounters:
        """Totals since the camera was made, over all times that it was open."""

    @property
    def status(self) -> CameraStatus:
        """The status now. Override it if `open` returns before the camera can deliver."""
        return CameraStatus(CameraState.STREAMING)

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics: "camera file FILE", a topic, "factory"; "" = exact."""
        return ""

    @property
    def depth_unit_source(self) -> str:
        """The origin of the depth factor; "" if the unit is certain."""
        return self.intrinsics_source or "the camera"

    def wait_for_reconnect(self, timeout_s: float) -> None:
        """Wait before the next `open`; return early if a device is plugged in."""
        time.sleep(timeout_s)

    @property
    def has_motor(self) -> bool:
        """Whether the camera has a tilt motor and an LED."""
        return False

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head against the horizon: up is positive, at most +-31 degrees.

        Thread-safe. The setting is applied again whenever the camera is opened.

        Raises:
            CameraError: There is no motor, or it does not answer now. In the latter case the
                setting is applied as soon as possible.
        """
        raise CameraError(f"{self.name}: it has no motor")

    def set_led(self, led: Led) -> None:
        """Set the LED. Thread-safe, persistence and errors are those of `set_tilt_deg`."""
        raise CameraError(f"{self.name}: it has no LED")

    @property
    def can_drive(self) -> bool:
        """Whether the camera is on a simulated base that can be driven."""
        return False

    def set_velocity(self, forward_m_s: float, yaw_rad_s: float) -> None:
        """Drive the base: forward and to the left are positive. Thread-safe; returns at once.

        The base limits the velocities, and stops half a second after the last call.

        Raises:
            CameraError: It has no base.
            InputError: A number is not finite.
        """
        raise CameraError(f"{self.name}: it is not on a base that can be driven")

    @property
    def frame_count(self) -> int | None:
        """The number of frames of the source, if it is known: for progress."""
        return None

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses of the color camera, if the source knows them."""
        return None

    def recorded_odometry(self, topics: Collection[str]) -> Iterator[bytes]:
        """Yield the messages of a base's odometry that were recorded beside the frames.

        Args:
            topics: Topics, with the first slash.

        Returns:
            CDR ``nav_msgs/msg/Odometry``, in the order of recording.

        Raises:
            InputError: The recording is damaged; while iterating.
        """
        return iter(())

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()


# Makes a camera in a worker process: a class or function of a module, or a partial of one.
CameraFactory = Callable[[], RgbdCamera]
