"""A dump in libfreenect's own format, played by fakenect, a replacement of libfreenect."""

import ctypes
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

import numpy as np

from drivers.camera import Clock, EndOfStream, PlaybackMode
from drivers.core.errors import InputError, UserFacingError
from drivers.core.flow_control import BlockingQueue, BoundedQueue, DropOldestQueue
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.device_source import DeviceCalibration, StreamTimeouts
from drivers.freenect.factory_calibration import ValidDepthMask, all_depths_to_10_m
from drivers.freenect.image_buffers import ImagePair
from drivers.freenect.library import PACKAGE, DepthFormat, load_library

PATH_VARIABLE = "FAKENECT_PATH"
SYSTEM_LIBRARY_FOLDER = Path("/usr/lib")
LIBRARY_PATTERN = "fakenect/libfreenect.so.0.5"


class RecordedStampConverter:
    """Keeps the stamps of the recorded device."""

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        return device_s


class FakenectSource:
    """Plays a dump once from its start; its depth must be registered and in millimeters.

    fakenect plays at the times in the file names. In lockstep it also waits for the reader.
    It ends the whole process if the dump is invalid, so the dump is checked first.

    Args:
        folder: The folder of the dump.
        playback_mode: Lockstep or realtime.
        library: File of fakenect; None for the system's.
    """

    clock = Clock.RECORDED
    timeouts = StreamTimeouts(first_image_s=inf, next_image_s=inf)
    min_period_s = 0.0

    def __init__(
        self, folder: Path, playback_mode: PlaybackMode, library: Path | None = None
    ) -> None:

        self.name = f"fakenect:{folder}"
        self._folder, self._playback_mode, self._library = folder, playback_mode, library

    def load(self) -> ctypes.CDLL:
        """Check the dump and load a copy of fakenect, which can play only once per library."""
        check_dump_folder(self._folder)
        os.environ[PATH_VARIABLE] = str(self._folder.resolve())
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(self._library or _find_system_library(), folder)
            return load_library(str(copy))

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        with context.open_device("") as device:
            assert device is not None, "fakenect opens any serial number"
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """Return the only format with which fakenect does not end the process."""
        return DepthFormat.RAW_11_BIT

    def configure(self, device: FreenectDevice) -> DeviceCalibration:
        """Return a filter up to 10 m; fakenect has no settings and no table."""
        return DeviceCalibration(ValidDepthMask(all_depths_to_10_m()))

    def make_end_exception(self) -> Exception:
        return EndOfStream()

    def make_queue(self) -> BoundedQueue[ImagePair]:
        is_lockstep = self._playback_mode is PlaybackMode.LOCKSTEP
        return BlockingQueue(1) if is_lockstep else DropOldestQueue(1)

    def make_stamp_converter(self) -> RecordedStampConverter:
        return RecordedStampConverter()


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
    try:
        lines = index.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{index}: cannot be read ({_error_text(error)}); a dump is a folder with "
            f"{INDEX_FILE} and the files that it names"
        ) from error
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
        with path.open("rb") as file:
            size = path.stat().st_size
            return file.read(max(0, size - pixel_bytes))[:1000]
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({_error_text(error)}); {INDEX_FILE} names it"
        ) from error


def _check_unit(path: Path) -> None:
    depth = np.frombuffer(path.read_bytes()[-PIXEL_BYTES["d"] :], dtype="<u2")
    if depth.max() == NO_DEPTH_RAW:
        raise InputError(
            f"{path}: holds raw 11-bit depth, as fakenect-record writes it; only a dump of "
            "registered depth in millimeters can be played"
        )


def _error_text(error: OSError | UnicodeDecodeError) -> str:
    return error.strerror or "" if isinstance(error, OSError) else "not a text file"
