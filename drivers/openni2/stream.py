"""The image stream of one sensor of libOpenNI2."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.openni2.library import (
    Cropping,
    OniFrame,
    OpenNI2Error,
    SensorType,
    StreamProperty,
    VideoMode,
    check_status,
    read_property,
)


class OpenNI2Stream:
    """The image stream of one sensor. Its methods raise OpenNI2Error if a call fails."""

    def __init__(self, library: ctypes.CDLL, device: ctypes.c_void_p, sensor: SensorType) -> None:
        self._library, self.sensor = library, sensor
        self.handle = ctypes.c_void_p()
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
    def fov_rad(self) -> tuple[float, float]:
        """Horizontal and vertical field of view; zeros if the sensor does not report them."""
        horizontal, vertical = ctypes.c_float(0.0), ctypes.c_float(0.0)
        self._read_property(StreamProperty.HORIZONTAL_FOV, horizontal)
        self._read_property(StreamProperty.VERTICAL_FOV, vertical)
        return horizontal.value, vertical.value

    @property
    def is_mirrored(self) -> bool:
        """Whether left and right are swapped; False if the sensor does not report it."""
        mirrored = ctypes.c_int(0)
        self._read_property(StreamProperty.MIRRORING, mirrored)
        return mirrored.value != 0

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

    def _read_property(self, prop: StreamProperty, value: Any) -> bool:
        return read_property(self._library.oniStreamGetProperty, self.handle, prop, value)

    def _set_property(self, prop: StreamProperty, value: Any) -> None:
        status = self._library.oniStreamSetProperty(
            self.handle, prop, ctypes.byref(value), ctypes.sizeof(value)
        )
        check_status(
            self._library, status, f"{self.sensor.name.lower()}: {prop.name} cannot be set"
        )
