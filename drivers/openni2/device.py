"""A device of OpenNI2, and the list of those that are connected."""

import ctypes
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from drivers.core import CameraError, CameraNotFoundError
from drivers.openni2.bindings import (
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
    OpenNI2Error,
    SensorType,
    VideoMode,
    check_status,
    read_property,
)
from drivers.openni2.stream import OpenNI2Stream

# A driver's thread may still use a stream after its stop, and destroying the stream then crashes.
# The library does not report when the thread has finished.
SETTLE_S = 0.2
NO_USB_ID = (0, 0)


@dataclass(frozen=True)
class DetectedDevice:
    """A device that libOpenNI2 lists."""

    uri: str
    vendor: str
    name: str
    usb_id: tuple[int, int]


def detect_devices(openni2: OpenNI2) -> list[DetectedDevice]:
    """List the connected devices, without the open recordings that the library lists too."""
    library = openni2.library
    devices, count = ctypes.POINTER(DeviceInfo)(), ctypes.c_int()
    status = library.oniGetDeviceList(ctypes.byref(devices), ctypes.byref(count))
    check_status(library, status, "OpenNI2 cannot list its devices")
    listed = [_make_detected_device(devices[i]) for i in range(count.value)]
    library.oniReleaseDeviceList(devices)
    return [device for device in listed if device.usb_id != NO_USB_ID]


def _make_detected_device(info: DeviceInfo) -> DetectedDevice:
    uri, vendor, name = (t.decode(errors="replace") for t in (info.uri, info.vendor, info.name))
    return DetectedDevice(uri, vendor, name, (info.usb_vendor, info.usb_product))


class OpenNI2Device:
    """An open device or recording. The caller must close it."""

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
        """Whether the device has this sensor."""
        return bool(self._library.oniDeviceGetSensorInfo(self._handle, sensor))

    def video_modes(self, sensor: SensorType) -> list[VideoMode]:
        """List the video modes of a sensor."""
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
        """The serial number; "" if the device does not report it."""
        text = ctypes.create_string_buffer(MAX_TEXT_BYTES)
        self._read_property(DeviceProperty.SERIAL, text)
        return text.value.decode(errors="replace")

    def enable_depth_registration(self, is_wanted: bool) -> bool:
        """Switch the registration of depth to color on or off; return whether it is on."""
        supports = self._library.oniDeviceIsImageRegistrationModeSupported
        # Some drivers accept a mode that they do not support, and then report it as set.
        if not supports(self._handle, REGISTRATION_DEPTH_TO_COLOR):
            return False
        mode = ctypes.c_int(REGISTRATION_DEPTH_TO_COLOR if is_wanted else REGISTRATION_OFF)
        self.set_property(DeviceProperty.IMAGE_REGISTRATION, mode)
        self._read_property(DeviceProperty.IMAGE_REGISTRATION, mode)
        return mode.value == REGISTRATION_DEPTH_TO_COLOR

    def enable_depth_color_sync(self) -> bool:
        """Enable synchronous capture of depth and color; return whether it is on."""
        status = self._library.oniDeviceEnableDepthColorSync(self._handle)
        return status == 0 and bool(self._library.oniDeviceGetDepthColorSyncEnabled(self._handle))

    def wait_for_any_stream(
        self, streams: Sequence[OpenNI2Stream], timeout_s: float
    ) -> OpenNI2Stream | None:
        """Wait for the first stream that has a frame; None after `timeout_s`."""
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
        """Within the block, call `callback` on another thread when this device is unplugged."""
        uri = self._read_info().uri

        def on_disconnect(info: Any, _: Any) -> None:
            if info.contents.uri == uri:
                callback()

        functions = DeviceCallbacks(
            DEVICE_CALLBACK(), DEVICE_CALLBACK(on_disconnect), STATE_CALLBACK()
        )
        handle = ctypes.c_void_p()
        status = self._library.oniRegisterDeviceCallbacks(
            ctypes.byref(functions), None, ctypes.byref(handle)
        )
        check_status(self._library, status, "cannot detect unplugging")
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
        check_status(self._library, status, "the device's information cannot be read")
        return info

    def _read_property(self, prop: DeviceProperty, value: Any) -> bool:
        return read_property(self._library.oniDeviceGetProperty, self._handle, prop, value)


def list_devices() -> list[DetectedDevice]:
    """List the PrimeSense, Xtion and other sensors that libOpenNI2 has drivers for.

    Raises:
        UserFacingError: libOpenNI2 is not installed.
        CameraError: libOpenNI2 does not start.
    """
    return detect_devices(OpenNI2())


def open_device(openni2: OpenNI2, device_id: str) -> OpenNI2Device:
    """Open the sensor with this URI or serial number, or the first one for "".

    Raises:
        CameraNotFoundError: The sensor is not connected.
        CameraError: The sensor is connected but cannot be opened.
    """
    detected_devices = detect_devices(openni2)
    for detected in detected_devices:
        if device_id in ("", detected.uri):
            return _open_detected(openni2, detected)
    for detected in detected_devices:
        if device := _open_if_serial(openni2, detected, device_id):
            return device
    return _open_unlisted(openni2, device_id, detected_devices)


def _open_detected(openni2: OpenNI2, detected: DetectedDevice) -> OpenNI2Device:
    try:
        return OpenNI2Device(openni2, detected.uri)
    except OpenNI2Error as error:
        raise CameraError(
            f"{detected.vendor} {detected.name} ({error}): it is plugged in, but another program "
            "uses it or this user may not open it; kinect-vo doctor shows which"
        ) from error


def _open_if_serial(
    openni2: OpenNI2, detected: DetectedDevice, serial: str
) -> OpenNI2Device | None:
    try:
        device = OpenNI2Device(openni2, detected.uri)
    except OpenNI2Error:
        return None
    if device.serial == serial:
        return device
    device.close()
    return None


def _open_unlisted(
    openni2: OpenNI2, device_id: str, detected_devices: list[DetectedDevice]
) -> OpenNI2Device:
    """Open a device by its URI: some drivers list a device only after that."""
    try:
        return OpenNI2Device(openni2, device_id)
    except OpenNI2Error as error:
        uris = ", ".join(detected.uri for detected in detected_devices)
        if not device_id:
            raise CameraNotFoundError(
                "no PrimeSense or Xtion sensor is plugged in (a Kinect is --camera freenect)"
            ) from error
        raise CameraNotFoundError(
            f"openni2:{device_id}: no sensor has this URI or serial number; "
            + (f"plugged in: {uris}" if uris else "none is plugged in")
        ) from error
