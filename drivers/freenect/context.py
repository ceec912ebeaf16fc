"""libfreenect's context and device, with calls in an order that works, and always released.

Its callbacks copy each image into a buffer of a pool.
"""

import ctypes
import logging
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core import CameraError
from drivers.freenect.bindings import (
    CAMERA_ONLY,
    FRAME_CALLBACK,
    INTERRUPTED,
    LOG_CALLBACK,
    LOG_SPEW,
    RESOLUTION_640X480,
    DeviceAttributes,
    Flag,
    Registration,
    StreamFormat,
    TimeValue,
)
from drivers.freenect.depth_tables import (
    COLUMNS,
    MAX_DEPTH_MM,
    RAW_VALUES,
    REGISTRATION_UNITS_PER_PX,
    ROWS,
    DepthTables,
)
from drivers.freenect.errors import start_failed_error
from drivers.freenect.factory_calibration import FactoryCalibration
from drivers.freenect.log import LibfreenectLog, StreamHealth
from drivers.time_sync import StampedPair, StampUnwrapper

_log = logging.getLogger(__name__)
# Rows and columns of the registration that are read: some of the middle half of the image.
_ROWS, _COLUMNS = slice(120, 360, 8), slice(160, 480, 8)
RawFrameCallback = Callable[[int, int], None]  # address of the pixels, device stamp


class FreenectContext:
    """A libfreenect context. libfreenect has no locks: one thread must make all the calls.

    After any failure, close it and make a new one, because libfreenect keeps half-open devices.
    """

    def __init__(self, library: ctypes.CDLL, log: LibfreenectLog) -> None:
        """Create the context.

        Raises:
            CameraError: If there is no access to USB at all.
        """
        self.library, self.log = library, log
        self._pointer = ctypes.c_void_p()
        if library.freenect_init(ctypes.byref(self._pointer), None) < 0:
            raise CameraError("libfreenect finds no USB: is /dev/bus/usb there in this container?")
        self._log_callback = LOG_CALLBACK(lambda _, level, text: log.add_line(level, text.decode()))
        library.freenect_set_log_callback(self._pointer, self._log_callback)
        library.freenect_set_log_level(self._pointer, LOG_SPEW)
        library.freenect_select_subdevices(self._pointer, CAMERA_ONLY)
        self._callback_error: Exception | None = None

    def close(self) -> None:
        """Release the context and all devices that are still open in it."""
        self.library.freenect_shutdown(self._pointer)

    def device_count(self) -> int:
        """Return the number of Kinects on the bus, including those without permission to open."""
        return int(self.library.freenect_num_devices(self._pointer))

    def list_serials(self) -> list[str]:
        """Return the serial numbers of the Kinects that this user may open."""
        first = ctypes.POINTER(DeviceAttributes)()
        self.library.freenect_list_device_attributes(self._pointer, ctypes.byref(first))
        serials, item = [], first
        while item:
            serials.append(item.contents.camera_serial.decode())
            item = item.contents.next
        self.library.freenect_free_device_attributes(first)
        return serials

    @contextmanager
    def open_device(self, serial: str) -> Iterator["FreenectDevice | None"]:
        """Open the Kinect with this serial number; None if libfreenect cannot open it."""
        pointer = ctypes.c_void_p()
        result = self.library.freenect_open_device_by_camera_serial(
            self._pointer, ctypes.byref(pointer), serial.encode()
        )
        if result < 0:
            yield None
            return
        device = FreenectDevice(self, pointer, serial)
        try:
            yield device
        finally:
            device.close()

    def make_event_processor(self, timeout: TimeValue) -> Callable[[], bool]:
        """Make the function that processes USB events, and returns False once the device is gone.

        It raises the exceptions of the callbacks. It is called 500 times a second, so its arguments
        are converted for C only once.
        """
        process = self.library.freenect_process_events_timeout
        context, timeout_pointer = self._pointer, ctypes.pointer(timeout)

        def process_events() -> bool:
            result = process(context, timeout_pointer)
            if self._callback_error is not None:
                raise self._callback_error
            return result >= 0 or result == INTERRUPTED  # type: ignore[no-any-return]

        return process_events

    def make_callback(self, function: RawFrameCallback) -> Any:
        """Wrap a function as a C callback; its exception is kept, as it cannot pass through C."""

        def callback(_device: int, pixels: int, stamp: int) -> None:
            try:
                function(pixels, stamp)
            except Exception as error:
                self._callback_error = error

        return FRAME_CALLBACK(callback)


class FreenectDevice:
    """An open Kinect."""

    def __init__(self, context: FreenectContext, pointer: ctypes.c_void_p, serial: str) -> None:
        self._library, self._pointer, self._context = context.library, pointer, context
        self.serial, self.log = serial, context.log
        self._callbacks: list[Any] = []

    def start(
        self,
        color: StreamFormat,
        depth: StreamFormat,
        on_color: RawFrameCallback,
        on_depth: RawFrameCallback,
    ) -> None:
        """Start both streams at 640x480. Raises CameraError."""
        library, pointer = self._library, self._pointer
        self._callbacks = [
            self._context.make_callback(on_color),
            self._context.make_callback(on_depth),
        ]
        library.freenect_set_video_callback(pointer, self._callbacks[0])
        library.freenect_set_depth_callback(pointer, self._callbacks[1])
        video_mode = library.freenect_find_video_mode(RESOLUTION_640X480, color.number)
        depth_mode = library.freenect_find_depth_mode(RESOLUTION_640X480, depth.number)
        for step, call, *arguments in (
            ("set the color mode", library.freenect_set_video_mode, video_mode),
            ("set the depth mode", library.freenect_set_depth_mode, depth_mode),
            ("start depth", library.freenect_start_depth),
            ("start color", library.freenect_start_video),
        ):
            if call(pointer, *arguments) < 0:
                raise start_failed_error(step, self.log)

    def set_flag(self, flag: Flag, is_on: bool) -> None:
        """Set a flag of the color camera, once it streams; a failure is only logged."""
        if self._library.freenect_set_flag(self._pointer, flag, is_on) < 0:
            name, state = flag.name.lower().replace("_", " "), "on" if is_on else "off"
            _log.warning("the Kinect does not accept %s = %s", name, state)

    def read_factory_calibration(self) -> tuple[DepthTables, FactoryCalibration]:
        """Read the tables of depth, and the calibration."""
        registration = self._library.freenect_copy_registration(self._pointer)
        tables = _copy_tables(registration)
        self._library.freenect_destroy_registration(ctypes.byref(registration))
        return tables, _make_calibration(registration, tables)

    def close(self) -> None:
        """Stop both streams, then close: closing while both run crashes libfreenect later."""
        self._library.freenect_stop_depth(self._pointer)
        self._library.freenect_stop_video(self._pointer)
        self._library.freenect_close_device(self._pointer)


def _copy_tables(registration: Registration) -> DepthTables:
    as_array = np.ctypeslib.as_array
    return DepthTables(
        as_array(registration.raw_to_mm, (RAW_VALUES,)).copy(),
        as_array(registration.depth_to_rgb_shift, (MAX_DEPTH_MM,)).copy(),
        as_array(registration.registration_table, (ROWS, COLUMNS, 2)).copy(),
        # libfreenect multiplies the skipped rows by the number of rows, not of columns.
        skipped_pixels=ROWS * registration.padding[0],
    )


def _make_calibration(registration: Registration, tables: DepthTables) -> FactoryCalibration:
    # The reference plane is divided into the 1280 columns of the depth sensor, two for each pixel.
    plane_mm, pixel_mm = registration.reference_distance_mm, 2.0 * registration.reference_pixel_mm
    rows, columns = np.mgrid[_ROWS, _COLUMNS]
    return FactoryCalibration(
        depth_focal_px=plane_mm / pixel_mm if pixel_mm else 0.0,
        depth_px=np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64),
        color_px=tables.registration[_ROWS, _COLUMNS].reshape(-1, 2)
        / (REGISTRATION_UNITS_PER_PX, 1.0),
    )


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class PooledImage:
    """One image in its buffer.

    Attributes:
        seq: Number of the image in its stream, lost ones included.
        receive_time_s: CLOCK_MONOTONIC when the host had received all of it.
        pixels: In the shape of the stream's `StreamFormat`.
    """

    seq: int
    receive_time_s: float
    pixels: NDArray[Any]


ImagePair = StampedPair[PooledImage, PooledImage]


# Pairing holds up to 4 images of a stream; one is queued, one read, one written, one spare.
POOL_SIZE = 8

ImageHandler = Callable[[float, PooledImage], None]


class BufferPool:
    """A pool of image buffers. A buffer is free again when its image is no longer referenced."""

    def __init__(self, image: StreamFormat) -> None:
        self._buffers: list[NDArray[Any]] = [
            np.zeros(image.shape, image.dtype) for _ in range(POOL_SIZE)
        ]
        self._image_refs: list[Callable[[], PooledImage | None]] = [lambda: None] * POOL_SIZE

    def copy_image(self, address: int, seq: int, receive_time_s: float) -> PooledImage:
        """Copy the pixels at `address` into a free buffer."""
        free = next(index for index, image in enumerate(self._image_refs) if image() is None)
        pixels = self._buffers[free]
        ctypes.memmove(pixels.ctypes.data, address, pixels.nbytes)
        image = PooledImage(seq, receive_time_s, pixels)
        self._image_refs[free] = weakref.ref(image)
        return image


class FrameCallback:
    """Receives one stream's images from libfreenect and passes on the complete ones."""

    def __init__(
        self,
        pool: BufferPool,
        stamp_unwrapper: StampUnwrapper,
        health: StreamHealth,
        on_image: ImageHandler,
    ) -> None:
        self._pool, self._stamp_unwrapper = pool, stamp_unwrapper
        self._health, self._on_image = health, on_image

    def handle_frame(self, address: int, stamp: int) -> None:
        """Copy an image. The callback must be short, as USB packets get lost after 32 ms."""
        receive_time_s = time.monotonic()
        is_whole = self._health.add_delivered(receive_time_s)
        device_s = self._stamp_unwrapper.unwrap_s(stamp)
        if is_whole:
            seq = self._health.images - 1
            self._on_image(device_s, self._pool.copy_image(address, seq, receive_time_s))
