"""The image stream of one sensor of libOpenNI2."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.openni2.bindings import (
    Cropping,
    OniFrame,
    OpenNI2Error,
    PixelFormat,
    SensorType,
    StreamProperty,
    VideoMode,
    check_status,
    read_property,
)

# Depth values per meter.
DEPTH_FACTORS = {PixelFormat.DEPTH_1_MM: 1000.0, PixelFormat.DEPTH_100_UM: 10000.0}
TO_BGR = {
    PixelFormat.RGB888: (cv2.COLOR_RGB2BGR, 3),
    PixelFormat.YUV422: (cv2.COLOR_YUV2BGR_UYVY, 2),
    PixelFormat.YUYV: (cv2.COLOR_YUV2BGR_YUYV, 2),
    PixelFormat.GRAY8: (cv2.COLOR_GRAY2BGR, 1),
}


class IncompleteFrameError(Exception):
    """A frame whose size differs from its stream's video mode."""


def format_name(mode: VideoMode) -> str:
    """Return the name of a pixel format, or its number."""
    return (
        PixelFormat(mode.format).name
        if mode.format in set(PixelFormat)
        else f"number {mode.format}"
    )


def _decode_color(frame: OniFrame) -> NDArray[np.uint8]:
    code, channels = TO_BGR[PixelFormat(frame.mode.format)]
    return cv2.cvtColor(_pixels(frame, channels), code)  # type: ignore[return-value]


def _decode_depth(frame: OniFrame) -> NDArray[np.uint16]:
    return _pixels(frame, 2).view(np.uint16)[..., 0].copy()


def _pixels(frame: OniFrame, channels: int) -> NDArray[np.uint8]:
    """Return a (height, width, channels) uint8 view of the library's memory."""
    height, width = frame.height, frame.width
    is_whole = (width, height) == (frame.mode.width, frame.mode.height)
    if not is_whole or frame.size != height * width * channels:
        raise IncompleteFrameError(
            f"{frame.size} bytes of {width}x{height} where {frame.mode.width}x{frame.mode.height} "
            "are expected"
        )
    memory = (ctypes.c_uint8 * frame.size).from_address(frame.data)
    return np.frombuffer(memory, np.uint8).reshape(height, width, channels)


class OpenNI2Stream:
    """The image stream of one sensor. Its methods raise OpenNI2Error if a call fails.

    Attributes:
        flips: Whether `decode` swaps left and right.
    """

    def __init__(self, library: ctypes.CDLL, device: ctypes.c_void_p, sensor: SensorType) -> None:
        self._library, self.sensor = library, sensor
        self.handle, self.flips = ctypes.c_void_p(), False
        status = library.oniDeviceCreateStream(device, sensor, ctypes.byref(self.handle))
        check_status(library, status, f"no {sensor.name.lower()} stream")

    def start(self) -> None:
        """Start delivering images."""
        what = f"the {self.sensor.name.lower()} stream cannot be started"
        check_status(self._library, self._library.oniStreamStart(self.handle), what)

    @property
    def video_mode(self) -> VideoMode:
        """Format, size and rate."""
        mode = VideoMode()
        if not self._read_property(StreamProperty.VIDEO_MODE, mode):
            raise OpenNI2Error(f"the {self.sensor.name.lower()} stream has no video mode")
        return mode

    def set_video_mode(self, mode: VideoMode) -> None:
        """Set one of the device's modes, before `start`."""
        # A sensor with a single mode may reject setting it.
        if bytes(mode) != bytes(self.video_mode):
            self._set_property(StreamProperty.VIDEO_MODE, mode)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images."""
        return self.video_mode.width, self.video_mode.height

    @property
    def fov_rad(self) -> tuple[float, float]:
        """Horizontal and vertical field of view; zeros if the sensor does not report them."""
        horizontal, vertical = ctypes.c_float(0.0), ctypes.c_float(0.0)
        self._read_property(StreamProperty.HORIZONTAL_FOV, horizontal)
        self._read_property(StreamProperty.VERTICAL_FOV, vertical)
        return horizontal.value, vertical.value

    def mirror(self, is_wanted: bool) -> None:
        """Decode images mirrored or not, whether or not the sensor mirrors them."""
        mirrored = ctypes.c_int(0)
        self._read_property(StreamProperty.MIRRORING, mirrored)
        self.flips = (mirrored.value != 0) != is_wanted

    @property
    def cropping(self) -> Cropping | None:
        """The delivered part of the image; None if the sensor does not report it."""
        cropping = Cropping()
        return cropping if self._read_property(StreamProperty.CROPPING, cropping) else None

    def has_property(self, prop: StreamProperty) -> bool:
        """Whether the stream has a property."""
        return bool(self._library.oniStreamIsPropertySupported(self.handle, prop))

    def set_flag(self, prop: StreamProperty, is_on: bool) -> None:
        """Set a boolean property."""
        self._set_property(prop, ctypes.c_int(is_on))

    @contextmanager
    def read_frame(self) -> Iterator[OniFrame]:
        """Read the next image, which is valid within the block.

        Blocks until there is one; call `OpenNI2Device.wait_for_any_stream` first.
        """
        pointer = ctypes.POINTER(OniFrame)()
        status = self._library.oniStreamReadFrame(self.handle, ctypes.byref(pointer))
        check_status(self._library, status, f"no frame from the {self.sensor.name.lower()} stream")
        if not pointer:
            raise OpenNI2Error(f"an empty frame from the {self.sensor.name.lower()} stream")
        try:
            yield pointer.contents
        finally:
            self._library.oniFrameRelease(pointer)

    def decode(self, frame: OniFrame) -> NDArray[Any]:
        """Copy an image: (height, width, 3) uint8 BGR, or (height, width) uint16, 0 = no reading.

        Raises:
            IncompleteFrameError: If the image is incomplete.
        """
        image = _decode_color(frame) if self.sensor is SensorType.COLOR else _decode_depth(frame)
        return cv2.flip(image, 1) if self.flips else image

    def _read_property(self, prop: StreamProperty, value: Any) -> bool:
        return read_property(self._library.oniStreamGetProperty, self.handle, prop, value)

    def _set_property(self, prop: StreamProperty, value: Any) -> None:
        status = self._library.oniStreamSetProperty(
            self.handle, prop, ctypes.byref(value), ctypes.sizeof(value)
        )
        check_status(
            self._library, status, f"{self.sensor.name.lower()}: {prop.name} cannot be set"
        )
