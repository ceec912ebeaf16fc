"""Playback of every image of a recording by libOpenNI2."""

import ctypes
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from drivers.camera import FrameTimeout
from drivers.core import CameraError, InputError
from drivers.openni2.bindings import DeviceProperty, OniFrame, OpenNI2, OpenNI2Error, SensorType
from drivers.openni2.device import OpenNI2Device
from drivers.openni2.oni_index import IndexedImage
from drivers.openni2.source_properties import read_source_properties
from drivers.openni2.stream import DEPTH_FACTORS, TO_BGR, OpenNI2Stream, format_name
from drivers.rectify import DepthRegistration, SourceProperties

# The next image is played only when it is read. (0 would be as fast as possible, and drops.)
SPEED_ON_DEMAND = -1.0
# An image arrives at once, unless the library has stopped playing the file.
IMAGE_TIMEOUT_S = 2.0


class OniPlayer:
    """Plays a file whose index has been read. Raises InputError."""

    def __init__(self, openni2: OpenNI2, path: Path, mirror: bool) -> None:
        self._path = path
        with ExitStack() as undo:
            # A short and unique path: the library shares one player per path, and has no room for
            # long paths.
            uri = f"/proc/self/fd/{undo.enter_context(path.open('rb')).fileno()}"
            try:
                self._device = OpenNI2Device(openni2, uri)
                undo.callback(self._device.close)
                # Repeating needs seeking, which hangs.
                self._device.set_property(DeviceProperty.PLAYBACK_REPEAT, ctypes.c_int(0))
                self._device.set_property(
                    DeviceProperty.PLAYBACK_SPEED, ctypes.c_float(SPEED_ON_DEMAND)
                )
                self._streams = {
                    sensor: self._device.create_stream(sensor) for sensor in SensorType
                }
            except OpenNI2Error as error:
                raise InputError(f"{path}: libOpenNI2 cannot play it: {error}") from error
            for stream in self._streams.values():
                _check_stream(stream, path)
                stream.mirror(mirror)
            self._exit_stack = undo.pop_all()
        self._waited_s = 0.0

    def read_properties(self) -> SourceProperties:
        """Read the properties of the images."""
        color, depth = self._streams[SensorType.COLOR], self._streams[SensorType.DEPTH]
        name = f"openni2:{self._path}"
        return read_source_properties(name, color, depth, DepthRegistration.UNKNOWN)

    def start(self) -> None:
        """Start playback. Then wait for and read every image of the index, in its order."""
        for stream in self._streams.values():
            stream.start()

    def wait_for_image(self, expected: IndexedImage, timeout_s: float) -> None:
        """Wait for the next image of the file.

        Raises:
            FrameTimeout: It did not arrive within `timeout_s`.
            CameraError: The library has stopped playing the file.
        """
        begin_s = time.monotonic()
        stream = self._streams[expected.sensor]
        if self._device.wait_for_any_stream([stream], timeout_s):
            self._waited_s = 0.0
            return
        self._waited_s += time.monotonic() - begin_s
        if self._waited_s > IMAGE_TIMEOUT_S:
            raise CameraError(f"{self._path}: libOpenNI2 stopped before the {expected}")
        raise FrameTimeout

    @contextmanager
    def read_image(self, expected: IndexedImage) -> Iterator[OniFrame]:
        """Read the image after `wait_for_image`; it is valid within the block.

        Raises:
            CameraError: The library played another image.
        """
        with self._streams[expected.sensor].read_frame() as frame:
            if frame.stamp_us != expected.stamp_us:
                raise CameraError(
                    f"{self._path}: libOpenNI2 played {frame.stamp_us / 1e6:.6f} s instead of the "
                    f"{expected}"
                )
            yield frame

    def decode(self, frame: OniFrame) -> NDArray[Any]:
        """Copy an image within the block, see `OpenNI2Stream.decode`."""
        return self._streams[SensorType(frame.sensor)].decode(frame)

    def stop(self) -> None:
        """Stop after the last image; otherwise the library keeps a core busy at the file's end."""
        self._device.stop()

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._exit_stack.close()


def _check_stream(stream: OpenNI2Stream, path: Path) -> None:
    """Raise InputError for a stream that is not supported."""
    try:
        mode, name = stream.video_mode, stream.sensor.name.lower()
    except OpenNI2Error as error:
        raise InputError(f"{path}: {error}; record it again") from error
    formats = DEPTH_FACTORS if stream.sensor is SensorType.DEPTH else TO_BGR
    if mode.format not in formats:
        names = ", ".join(pixel_format.name for pixel_format in formats)
        raise InputError(
            f"{path}: its {name} format ({format_name(mode)}) is not supported; record one of "
            f"{names}"
        )
    cropping = stream.cropping
    if cropping is None:
        raise InputError(
            f"{path}: its {name} stream lacks the cropping property, without which libOpenNI2 "
            "plays no image; record it again from a real sensor"
        )
    if cropping.is_on:
        raise InputError(
            f"{path}: its {name} images are cropped to {cropping.width}x{cropping.height}; record "
            "whole images"
        )
