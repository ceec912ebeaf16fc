"""A device or a recording of libOpenNI2 and its streams, opened and taken down in the right order.

Raises OpenNI2Error where a call fails.
"""

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from drivers.openni2.library import (
    DEVICE_CALLBACK,
    MAX_TEXT_BYTES,
    REGISTRATION_DEPTH_TO_COLOR,
    REGISTRATION_OFF,
    STATE_CALLBACK,
    TIMED_OUT,
    DeviceCallbacks,
    DeviceInfo,
    DeviceProperty,
    OpenNI2,
    SensorType,
    VideoMode,
    check_status,
    read_property,
)
from drivers.openni2.stream import OpenNI2Stream

# A driver's thread may still be on its way through a stream that has just been stopped, and
# destroying the stream under it crashes. Nothing tells when it is through.
SETTLE_S = 0.2
NO_USB_ID = (0, 0)


@dataclass(frozen=True)
class DetectedDevice:
    """A device that libOpenNI2 sees."""

    uri: str
    vendor: str
    name: str
    usb_id: tuple[int, int]


def detect_devices(openni2: OpenNI2) -> list[DetectedDevice]:
    """What is plugged in, without the recordings that have been opened: the library lists both."""
    library = openni2.library
    devices, count = ctypes.POINTER(DeviceInfo)(), ctypes.c_int()
    status = library.oniGetDeviceList(ctypes.byref(devices), ctypes.byref(count))
    check_status(library, status, "OpenNI2 cannot list its devices")
    found = [_make_detected_device(devices[i]) for i in range(count.value)]
    library.oniReleaseDeviceList(devices)
    return [device for device in found if device.usb_id != NO_USB_ID]


def _make_detected_device(info: DeviceInfo) -> DetectedDevice:
    uri, vendor, name = (t.decode(errors="replace") for t in (info.uri, info.vendor, info.name))
    return DetectedDevice(uri, vendor, name, (info.usb_vendor, info.usb_product))


class OpenNI2Device:
    """An open device or recording. Close it whatever happens."""

    def __init__(self, openni2: OpenNI2, uri: str) -> None:
        self._openni2, self._library = openni2, openni2.library
        self.streams: list[OpenNI2Stream] = []
        self._handle = ctypes.c_void_p()
        status = self._library.oniDeviceOpen(uri.encode(), ctypes.byref(self._handle))
        check_status(self._library, status, f"{uri} cannot be opened")

    def create_stream(self, sensor: SensorType) -> OpenNI2Stream:
        """Create the stream of a sensor."""
        stream = OpenNI2Stream(self._library, self._handle, sensor)
        self.streams.append(stream)
        return stream

    def has_sensor(self, sensor: SensorType) -> bool:
        """Whether there is such a sensor."""
        return bool(self._library.oniDeviceGetSensorInfo(self._handle, sensor))

    def video_modes(self, sensor: SensorType) -> list[VideoMode]:
        """What a sensor can deliver."""
        info = self._library.oniDeviceGetSensorInfo(self._handle, sensor).contents
        return [VideoMode.from_buffer_copy(info.modes[i]) for i in range(info.mode_count)]

    def set_property(self, prop: DeviceProperty, value: Any) -> None:
        """Set a property to a ctypes value."""
        status = self._library.oniDeviceSetProperty(
            self._handle, prop, ctypes.byref(value), ctypes.sizeof(value)
        )
        check_status(self._library, status, f"{prop.name} cannot be set")

    @property
    def serial(self) -> str:
        """The serial number; "" where the device does not tell."""
        text = ctypes.create_string_buffer(MAX_TEXT_BYTES)
        self._read_property(DeviceProperty.SERIAL, text)
        return text.value.decode(errors="replace")

    def enable_depth_registration(self, is_wanted: bool) -> bool:
        """Ask for depth in the color camera's pixels, or in its own; what is now the case."""
        supports = self._library.oniDeviceIsImageRegistrationModeSupported
        # Some drivers take a mode that they do not have, and then give it back as set.
        if not supports(self._handle, REGISTRATION_DEPTH_TO_COLOR):
            return False
        now = ctypes.c_int(REGISTRATION_DEPTH_TO_COLOR if is_wanted else REGISTRATION_OFF)
        self.set_property(DeviceProperty.IMAGE_REGISTRATION, now)
        self._read_property(DeviceProperty.IMAGE_REGISTRATION, now)
        return now.value == REGISTRATION_DEPTH_TO_COLOR

    def enable_depth_color_sync(self) -> bool:
        """Ask for depth and color to be taken together; whether they are."""
        status = self._library.oniDeviceEnableDepthColorSync(self._handle)
        return status == 0 and bool(self._library.oniDeviceGetDepthColorSyncEnabled(self._handle))

    def wait_for_any_stream(
        self, streams: Sequence[OpenNI2Stream], timeout_s: float
    ) -> OpenNI2Stream | None:
        """The first stream that has a frame; None after `timeout_s`."""
        handles = (ctypes.c_void_p * len(streams))(*(stream.handle for stream in streams))
        ready = ctypes.c_int(-1)
        status = self._library.oniWaitForAnyStream(
            handles, len(streams), ctypes.byref(ready), max(0, round(timeout_s * 1e3))
        )
        if status == TIMED_OUT:
            return None
        check_status(self._library, status, "waiting for a frame failed")
        return streams[ready.value]

    @contextmanager
    def on_unplug(self, callback: Callable[[], None]) -> Iterator[None]:
        """Within the block, `call` is called (by another thread) when this device goes away."""
        uri = self._read_info().uri

        def gone(info: Any, _: Any) -> None:
            if info.contents.uri == uri:
                callback()

        functions = DeviceCallbacks(DEVICE_CALLBACK(), DEVICE_CALLBACK(gone), STATE_CALLBACK())
        handle = ctypes.c_void_p()
        status = self._library.oniRegisterDeviceCallbacks(
            ctypes.byref(functions), None, ctypes.byref(handle)
        )
        check_status(self._library, status, "unplugging cannot be watched")
        try:
            yield
        finally:
            self._library.oniUnregisterDeviceCallbacks(handle)

    def stop(self) -> None:
        """Stop all streams."""
        for stream in self.streams:
            self._library.oniStreamStop(stream.handle)

    def close(self) -> None:
        """Stop all streams, wait for them to settle, then destroy them and close the device."""
        self.stop()
        time.sleep(SETTLE_S)
        while self.streams:
            self._library.oniStreamDestroy(self.streams.pop().handle)
        if self._handle:
            self._library.oniDeviceClose(self._handle)
            self._handle = ctypes.c_void_p()

    def _read_info(self) -> DeviceInfo:
        info = DeviceInfo()
        status = self._library.oniDeviceGetInfo(self._handle, ctypes.byref(info))
        check_status(self._library, status, "the device says nothing of itself")
        return info

    def _read_property(self, prop: DeviceProperty, value: Any) -> bool:
        return read_property(self._library.oniDeviceGetProperty, self._handle, prop, value)
