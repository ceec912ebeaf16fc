"""The checks of each camera, in order (new ones are listed here only), and of its libraries."""

import ctypes
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from drivers.camera import is_serial
from drivers.core import UserFacingError
from drivers.kinect_usb.audio_motor import MIN_INTERFACES_WITH_FIRMWARE
from drivers.kinect_usb.usb_ids import SensorModel
from drivers.openni2.device import DetectedDevice, list_devices
from drivers.registry import ONI_SUFFIX
from vo_service.tools.doctor.check import Check, CheckContext, RequestedSensor
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream_checks import (
    ClockRateCheck,
    FirstFramesCheck,
    FrameRateCheck,
    GravityCheck,
    LearnedFocalLengthCheck,
    LearnedTimingCheck,
    LostPacketsCheck,
    PlausibleFramesCheck,
    SkewCheck,
)
from vo_service.tools.doctor.stream_probe import call_in_subprocess
from vo_service.tools.doctor.usb_checks import (
    ControllerCheck,
    ExclusiveAccessCheck,
    KernelDriverCheck,
    PermissionCheck,
    SensorPresenceCheck,
    UsbSpeedCheck,
)
from vo_service.tools.doctor.usb_probe import OpenError, UsbSensor

LOAD_TIMEOUT_S = 10.0
DEBIAN_PACKAGES = {
    "libfreenect.so.0.5": "libfreenect0.5",
    "libOpenNI2.so.0": "libopenni2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
FIRMWARE_FILE = "audios.bin"
# The folders that libfreenect searches, in its order.
FIRMWARE_FOLDERS = (
    Path(),
    Path("~/.libfreenect"),
    Path("/usr/local/share/libfreenect"),
    Path("/usr/share/libfreenect"),
)


@dataclass(frozen=True)
class LibraryInfo:
    """One library: the file that was loaded, or the error."""

    name: str
    file: str
    error: str


def load_libraries(names: Sequence[str]) -> list[LibraryInfo]:
    """Load libraries into this process in the given order, as the drivers do."""
    return [_load_library(name) for name in names]


def _load_library(name: str) -> LibraryInfo:
    try:
        ctypes.CDLL(name)
    except OSError as error:
        return LibraryInfo(name, "", str(error))
    # The file that the loader took; a search could find another one.
    stem = name.partition(".so")[0] + ".so"
    lines = Path("/proc/self/maps").read_text().splitlines()
    files = [line.split(maxsplit=5)[5] for line in lines if "/" in line]
    return LibraryInfo(
        name, next((file for file in files if Path(file).name.startswith(stem)), ""), ""
    )


class LibrariesCheck:
    """Check the libraries of one kind of camera."""

    name = "libraries"
    needs: tuple[str, ...] = ()

    def __init__(self, *names: str) -> None:
        self._names = names

    def run(self, context: CheckContext) -> Finding:
        try:
            libraries = call_in_subprocess(partial(load_libraries, self._names), LOAD_TIMEOUT_S)
        except UserFacingError as error:
            return failed(
                f"loading {', '.join(self._names)}: {error}",
                f"reinstall them: {self._install_command('--reinstall ')}",
            )
        files = {library.name: library.file for library in libraries}
        errors = [library.error for library in libraries if library.error]
        if errors:
            return failed("; ".join(errors), self._install_command(), files=files)
        return passed(", ".join(library.file or library.name for library in libraries), files=files)

    def _install_command(self, apt_options: str = "") -> str:
        packages = [DEBIAN_PACKAGES[name] for name in self._names if name in DEBIAN_PACKAGES]
        return f"sudo apt install {apt_options}{' '.join(packages)}"


class FirmwareCheck:
    """Check that the audio device has its firmware; images do not need it."""

    name = "firmware"
    needs = ("sensor",)

    def __init__(self, folders: tuple[Path, ...] = FIRMWARE_FOLDERS) -> None:
        self._folders = folders

    def run(self, context: CheckContext) -> Finding:
        sensor = context.sensor
        if sensor.model is SensorModel.K1414:
            return passed("this model needs no firmware")
        if sensor.audio_interfaces is None:
            return unknown("not known: the sensor's audio device is not on the USB")
        if sensor.audio_interfaces >= MIN_INTERFACES_WITH_FIRMWARE:
            return passed("loaded")
        files = [folder.expanduser() / FIRMWARE_FILE for folder in self._folders]
        existing = [str(file) for file in files if file.is_file()]
        searched = ", ".join(str(folder) for folder in self._folders)
        if existing:
            return warned(
                f"not loaded, although {existing[0]} exists; images do not need it",
                "unplug the sensor and its power supply, wait ten seconds, plug both in",
                file=existing[0],
            )
        return warned(
            f"not loaded: no {FIRMWARE_FILE} in {searched}; tilt, light and accelerometer do not "
            "work, images do",
            f"put Microsoft's {FIRMWARE_FILE} into {self._folders[-1]}, "
            "then plug the sensor in again",
            file="",
        )


OPENNI2_TIMEOUT_S = 15.0
_OPEN_ERROR_TEXTS = {
    OpenError.NONE: "",
    OpenError.PERMISSION: "this user may not open it",
    OpenError.BUSY: "another program has it",
    OpenError.GONE: "it has just been unplugged",
}


@dataclass(frozen=True)
class ListedDevice:
    """One connected sensor.

    Attributes:
        camera: Value for --camera; "" if the sensor is not supported.
        name: Vendor and model.
        where: USB bus and port; "" if not known.
        serial: Serial number; "" if not known.
        error: Why it cannot be opened now; "" if no reason is known.
    """

    camera: str
    name: str
    where: str
    serial: str
    error: str

    def as_json(self) -> dict[str, str]:
        """Return the fields for --json; the keys are stable."""
        return asdict(self)


def list_available_devices(
    sensors: Sequence[UsbSensor], openni2: "OpenNI2Listing"
) -> list[ListedDevice]:
    """List all connected sensors. PrimeSense sensors have the names that OpenNI2 gives them."""
    kinects = [sensor for sensor in sensors if sensor.model in KINECT_MODELS]
    unsupported = [sensor for sensor in sensors if not sensor.is_supported]
    primesense = [sensor for sensor in sensors if sensor.model in PRIMESENSE_MODELS]
    return [
        *(_list_kinect(sensor) for sensor in kinects),
        *(_list_primesense(device) for device in openni2.devices),
        *(_list_without_driver(sensor, openni2) for sensor in primesense[len(openni2.devices) :]),
        *(_list_unsupported(sensor) for sensor in unsupported),
    ]


@dataclass(frozen=True)
class OpenNI2Listing:
    """Devices that libOpenNI2 finds, or the reason why it does not work."""

    devices: tuple[DetectedDevice, ...] = ()
    error: str = ""


def query_openni2() -> OpenNI2Listing:
    """List OpenNI2's devices in a subprocess."""
    try:
        return OpenNI2Listing(call_in_subprocess(_list_openni2_devices, OPENNI2_TIMEOUT_S))
    except UserFacingError as error:
        return OpenNI2Listing((), str(error))


def _list_openni2_devices() -> tuple[DetectedDevice, ...]:
    return tuple(list_devices())


def _list_kinect(sensor: UsbSensor) -> ListedDevice:
    has_serial = is_serial(sensor.serial)
    return ListedDevice(
        camera=f"freenect:{sensor.serial}" if has_serial else "freenect",
        name=sensor.model,
        where=sensor.where,
        serial=sensor.serial if has_serial else "",
        error=_OPEN_ERROR_TEXTS.get(sensor.open_error, sensor.open_error_text),
    )


def _list_primesense(device: DetectedDevice) -> ListedDevice:
    return ListedDevice(f"openni2:{device.uri}", f"{device.vendor} {device.name}", "", "", "")


def _list_without_driver(sensor: UsbSensor, openni2: OpenNI2Listing) -> ListedDevice:
    error = openni2.error or "libOpenNI2 does not see it"
    return ListedDevice("openni2", sensor.model, sensor.where, sensor.serial, error)


def _list_unsupported(sensor: UsbSensor) -> ListedDevice:
    return ListedDevice("", sensor.model, sensor.where, "", "not supported")


KINECT_MODELS = frozenset({SensorModel.K1414, SensorModel.K1473, SensorModel.K4W})
PRIMESENSE_MODELS = frozenset(
    {SensorModel.PRIMESENSE, SensorModel.XTION, SensorModel.XTION_LIVE, SensorModel.CARMINE}
)
SENSOR_HZ = 30.0
ANY_RATE_HZ = 0.0
USB_CHECKS: tuple[Check, ...] = (
    SensorPresenceCheck(),
    UsbSpeedCheck(),
    ControllerCheck(),
    PermissionCheck(),
    KernelDriverCheck(),
    ExclusiveAccessCheck(),
)
# No frame can arrive while one of these fails.
FRAME_PREREQUISITES = ("libraries", "sensor", "usb-speed", "permission", "sole-use")


def requested_sensor_for(source: str) -> RequestedSensor:
    """Return the sensors that `--camera SOURCE` means."""
    kind, _, argument = source.partition(":")
    if kind == "openni2":
        return RequestedSensor(PRIMESENSE_MODELS, "plug it in")
    return RequestedSensor(
        KINECT_MODELS, "plug it in, with its own power supply; its light must blink", argument
    )


def checks_for(source: str) -> tuple[Check, ...]:
    """Return the checks that apply to `--camera SOURCE`."""
    kind, _, argument = source.partition(":")
    if kind == "freenect":
        libraries = LibrariesCheck("libusb-1.0.so.0", "libfreenect.so.0.5")
        return (libraries, *USB_CHECKS, FirmwareCheck(), *_stream_checks(has_accelerometer=True))
    if kind == "openni2" and not argument.lower().endswith(ONI_SUFFIX):
        libraries = LibrariesCheck("libusb-1.0.so.0", "libOpenNI2.so.0")
        return (libraries, *USB_CHECKS, *_stream_checks(has_accelerometer=False))
    if kind == "openni2":
        return (
            LibrariesCheck("libOpenNI2.so.0"),
            FirstFramesCheck("libraries"),
            *_RECORDING_CHECKS,
        )
    return (FirstFramesCheck(), *_RECORDING_CHECKS)


def _stream_checks(has_accelerometer: bool) -> tuple[Check, ...]:
    return (
        FirstFramesCheck(*FRAME_PREREQUISITES),
        PlausibleFramesCheck(),
        FrameRateCheck(SENSOR_HZ),
        LostPacketsCheck(),
        SkewCheck(),
        LearnedTimingCheck(),
        LearnedFocalLengthCheck(),
        ClockRateCheck(),
        GravityCheck(has_accelerometer),
    )


# The speed of a player does not depend on the device's clock.
_RECORDING_CHECKS: tuple[Check, ...] = (
    PlausibleFramesCheck(),
    FrameRateCheck(ANY_RATE_HZ),
    LostPacketsCheck(),
    SkewCheck(),
    GravityCheck(is_expected=False),
)
