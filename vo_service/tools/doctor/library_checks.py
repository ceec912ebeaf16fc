"""Checks of what the drivers load: the libraries, and the firmware of a Kinect's audio device."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.core import UserFacingError
from drivers.kinect_usb.audio_motor import MIN_INTERFACES_WITH_FIRMWARE
from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.tools.doctor.check import CameraKind, CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.stream_probe import call_in_subprocess

LOAD_TIMEOUT_S = 10.0
LIBRARY_PACKAGES = {
    "libfreenect.so.0.5": "libfreenect0.5",
    "libOpenNI2.so.0": "libopenni2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
LIBRARIES = {
    CameraKind.KINECT: ("libusb-1.0.so.0", "libfreenect.so.0.5"),
    CameraKind.PRIMESENSE: ("libusb-1.0.so.0", "libOpenNI2.so.0"),
    CameraKind.ONI: ("libOpenNI2.so.0",),
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


def check_libraries(context: CheckContext) -> Finding:
    """Check the libraries of one kind of camera."""
    names = LIBRARIES[context.requested.kind]
    try:
        libraries = call_in_subprocess(partial(load_libraries, names), LOAD_TIMEOUT_S)
    except UserFacingError as error:
        return failed(
            f"loading {', '.join(names)}: {error}",
            f"reinstall them: {_install_command(names, '--reinstall ')}",
        )
    files = {library.name: library.file for library in libraries}
    errors = [library.error for library in libraries if library.error]
    if errors:
        return failed("; ".join(errors), _install_command(names), files=files)
    return passed(", ".join(library.file or library.name for library in libraries), files=files)


def _install_command(names: Sequence[str], apt_options: str = "") -> str:
    packages = [LIBRARY_PACKAGES[name] for name in names if name in LIBRARY_PACKAGES]
    return f"sudo apt install {apt_options}{' '.join(packages)}"


def check_firmware(context: CheckContext, folders: tuple[Path, ...] = FIRMWARE_FOLDERS) -> Finding:
    """Check that the audio device has its firmware; images do not need it."""
    sensor = context.sensor
    if sensor.model is SensorModel.K1414:
        return passed("this model needs no firmware")
    if sensor.audio_interfaces is None:
        return unknown("not known: the sensor's audio device is not on the USB")
    if sensor.audio_interfaces >= MIN_INTERFACES_WITH_FIRMWARE:
        return passed("loaded")
    files = [folder.expanduser() / FIRMWARE_FILE for folder in folders]
    existing = [str(file) for file in files if file.is_file()]
    searched = ", ".join(str(folder) for folder in folders)
    if existing:
        return warned(
            f"not loaded, although {existing[0]} exists; images do not need it",
            "unplug the sensor and its power supply, wait ten seconds, plug both in",
            file=existing[0],
        )
    return warned(
        f"not loaded: no {FIRMWARE_FILE} in {searched}; tilt, light and accelerometer do not "
        "work, images do",
        f"put Microsoft's {FIRMWARE_FILE} into {folders[-1]}, then plug the sensor in again",
        file="",
    )
