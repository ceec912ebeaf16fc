"""What libfreenect reads from: a Kinect on the USB, or a dump that fakenect plays."""

import ctypes
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from drivers.camera import Clock, EndOfStream, PlaybackMode, SensorConfig
from drivers.core import InputError, UserFacingError
from drivers.core.input_files import open_input, read_input, read_input_text
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue
from drivers.freenect.bindings import (
    COLOR_BAYER,
    COLOR_RGB,
    DEPTH_11_BIT,
    DEPTH_11_BIT_PACKED,
    PACKAGE,
    Flag,
    load_library,
)
from drivers.freenect.context import FreenectContext, FreenectDevice, ImagePair
from drivers.freenect.conversion import (
    DUMP_CONVERSION,
    ImageConversion,
    load_kernels,
    make_raw_conversion,
)
from drivers.freenect.errors import (
    NO_BANDWIDTH_LINE,
    device_not_found_error,
    no_bandwidth_error,
    no_permission_error,
    open_failed_error,
    unplugged_error,
)
from drivers.freenect.factory_calibration import FactoryCalibration
from drivers.time_sync import MIN_IMAGE_PERIOD_S, HostClockSync


@dataclass(frozen=True)
class StreamTimeouts:
    """Time limits for the first and for the next image of each stream."""

    first_image_s: float
    next_image_s: float


@dataclass(frozen=True)
class DeviceCalibration:
    """What a device says about itself; a dump has no factory calibration."""

    conversion: ImageConversion
    factory: FactoryCalibration | None = None


# Converts a stream's device stamp and its receive time to the camera's clock, for frames in order.
StampConverter = Callable[[float, float], float]

# The shortest time from a stamp until the host has the whole color image: 162 packets, one every
# 125 us. It is assumed that the stamp marks the first packet.
COLOR_READOUT_S = 162 * 125e-6


class KinectSource:
    """A Kinect 1414, 1473 or Kinect for Windows, by serial number ("" for the first one found).

    libfreenect passes on the images as the Kinect sends them.
    """

    clock = Clock.MONOTONIC
    color_format, depth_format = COLOR_BAYER, DEPTH_11_BIT_PACKED
    timeouts = StreamTimeouts(first_image_s=2.0, next_image_s=1.0)
    min_period_s = MIN_IMAGE_PERIOD_S

    def __init__(self, serial: str, settings: SensorConfig) -> None:
        self.name = f"freenect:{serial}" if serial else "freenect"
        self._serial, self._settings = serial, settings

    def load(self) -> ctypes.CDLL:
        """Load the library and the kernels. Raises UserFacingError without the library."""
        library = load_library()
        load_kernels()
        return library

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        """Find the device and open it. Raises CameraNotFoundError, CameraError."""
        with context.open_device(find_serial(context, self._serial)) as device:
            if device is None:
                raise open_failed_error(context.log)
            yield device

    def configure(self, device: FreenectDevice, *, registers_depth: bool) -> DeviceCalibration:
        """Set exposure and white balance, and read the calibration of the factory.

        Args:
            registers_depth: Whether the conversion registers depth to color.

        Raises:
            CameraError: The bus has not enough bandwidth for the streams.
        """
        if device.log.contains(NO_BANDWIDTH_LINE):
            raise no_bandwidth_error(device.log)
        device.set_flag(Flag.AUTO_EXPOSURE, self._settings.auto_exposure)
        device.set_flag(Flag.AUTO_WHITE_BALANCE, self._settings.auto_white_balance)
        tables, factory = device.read_factory_calibration()
        conversion = make_raw_conversion(tables, registers_depth=registers_depth)
        return DeviceCalibration(conversion, factory)

    def make_end_exception(self) -> Exception:
        """Make the exception for the end of libfreenect's events."""
        return unplugged_error()

    def make_queue(self) -> BoundedQueue[ImagePair]:
        """Make a queue that keeps the newest pair."""
        return DropOldestQueue(1)

    def make_stamp_converter(self) -> StampConverter:
        """Make the converter for the color stream, which starts with the first image."""
        return HostClockSync(COLOR_READOUT_S).to_host_s


def find_serial(context: FreenectContext, serial: str) -> str:
    """Return the serial number of the Kinect to open. Raises CameraNotFoundError, CameraError."""
    serials = context.list_serials()
    if not serials and context.device_count() > 0:
        raise no_permission_error()
    if not serials or serial not in {"", *serials}:
        raise device_not_found_error(serial, serials)
    return serial or serials[0]


PATH_VARIABLE = "FAKENECT_PATH"
SYSTEM_LIBRARY_FOLDER = Path("/usr/lib")
LIBRARY_PATTERN = "fakenect/libfreenect.so.0.5"


class FakenectSource:
    """Plays a dump once from its start; its depth must be registered and in millimeters.

    fakenect plays at the times in the file names. In lockstep it also waits for the reader.
    It ends the whole process if the dump is invalid, so the dump is checked first.
    """

    clock = Clock.RECORDED
    color_format = COLOR_RGB
    depth_format = DEPTH_11_BIT  # with another fakenect ends the process
    timeouts = StreamTimeouts(first_image_s=inf, next_image_s=inf)
    min_period_s = 0.0

    def __init__(self, folder: Path, playback_mode: PlaybackMode) -> None:
        self.name = f"fakenect:{folder}"
        self._folder, self._playback_mode = folder, playback_mode

    def load(self) -> ctypes.CDLL:
        """Check the dump and load a copy of fakenect, which can play only once per library."""
        check_dump_folder(self._folder)
        os.environ[PATH_VARIABLE] = str(self._folder.resolve())
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(_find_system_library(), folder)
            return load_library(str(copy))

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        with context.open_device("") as device:
            assert device is not None, "fakenect opens any serial number"
            yield device

    def configure(self, device: FreenectDevice, *, registers_depth: bool) -> DeviceCalibration:
        """Return conversions only; fakenect has no settings and no table."""
        return DeviceCalibration(DUMP_CONVERSION)

    def make_end_exception(self) -> Exception:
        return EndOfStream()

    def make_queue(self) -> BoundedQueue[ImagePair]:
        is_lockstep = self._playback_mode is PlaybackMode.LOCKSTEP
        return BlockingQueue(1) if is_lockstep else DropOldestQueue(1)

    def make_stamp_converter(self) -> StampConverter:
        """Return the converter that keeps the stamps of the recorded device."""
        return lambda device_s, receive_time_s: device_s


DeviceSource = KinectSource | FakenectSource


def _find_system_library() -> Path:
    found = sorted(SYSTEM_LIBRARY_FOLDER.glob(LIBRARY_PATTERN)) + sorted(
        SYSTEM_LIBRARY_FOLDER.glob(f"*/{LIBRARY_PATTERN}")
    )
    if not found:
        raise UserFacingError(f"fakenect is not installed: apt install {PACKAGE}")
    return found[0]


INDEX_FILE = "INDEX.txt"
NO_DEPTH_RAW = 2047
# Bytes of the pixels, which follow one line of text; "a" is the accelerometer, of any size.
PIXEL_BYTES = {"d": 480 * 640 * 2, "r": 480 * 640 * 3, "a": 0}
_FILE_NAME = re.compile(r"([dra])-[0-9.]+-[0-9]+\.[a-z]+")


def check_dump_folder(folder: Path) -> None:
    """Raise InputError if fakenect would end the process, or if the depth is raw 11-bit."""
    names = _read_index(folder)
    for name in names:
        _check_file(folder / name)
    for prefix, stream in (("d", "depth"), ("r", "color")):
        if not any(name.startswith(prefix) for name in names):
            raise InputError(
                f"{folder / INDEX_FILE}: names no {stream} image; record the dump again"
            )
    _check_unit(folder / next(name for name in names if name.startswith("d")))


def _read_index(folder: Path) -> list[str]:
    index = folder / INDEX_FILE
    advice = f"a dump is a folder with {INDEX_FILE} and the files that it names"
    lines = read_input_text(index, advice).split("\n")
    names = lines[:-1] if lines[-1] == "" else lines
    for number, name in enumerate(names, start=1):
        if not _FILE_NAME.fullmatch(name):
            raise InputError(
                f"{index}:{number}: {name!r} is not d-, r- or a-, time, stamp and ending, as in "
                "d-1234.567-890.pgm; record the dump again"
            )
    return names


def _check_file(path: Path) -> None:
    pixels = PIXEL_BYTES[path.name[0]]
    if not pixels:
        _read_header(path, 0)
        return
    header = _read_header(path, pixels)
    if not header.endswith(b"\n") or header.count(b"\n") != 1:
        raise InputError(
            f"{path}: is not one line of text and then {pixels} bytes of a 640x480 image; record "
            "the dump again"
        )


def _read_header(path: Path, pixel_bytes: int) -> bytes:
    """Read what precedes the pixels; b"" if the file is too short."""
    try:
        with open_input(path) as file:
            size = path.stat().st_size
            return file.read(max(0, size - pixel_bytes))[:1000]
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}; {INDEX_FILE} names it"
        ) from error


def _check_unit(path: Path) -> None:
    depth = np.frombuffer(read_input(path)[-PIXEL_BYTES["d"] :], dtype="<u2")
    if depth.max() == NO_DEPTH_RAW:
        raise InputError(
            f"{path}: holds raw 11-bit depth, as fakenect-record writes it; only a dump of "
            "registered depth in millimeters can be played"
        )
