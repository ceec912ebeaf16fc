"""A recorded folder in libfreenect's own format, played by fakenect: another libfreenect."""

import ctypes
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

from drivers.camera import Clock, EndOfStream, PlaybackMode
from drivers.errors import UserFacingError
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.depth import DepthFilter, ValidDepthMask, all_depths_to_10_m
from drivers.freenect.dump_folder import check_dump_folder
from drivers.freenect.library import PACKAGE, DepthFormat, load_library
from drivers.freenect.mailbox import BlockingFrameQueue, FrameQueue, LatestFrameQueue
from drivers.freenect.watchdog import StreamTimeouts

PATH_VARIABLE = "FAKENECT_PATH"
SYSTEM_LIBRARY_FOLDER = Path("/usr/lib")
LIBRARY_PATTERN = "fakenect/libfreenect.so.0.5"


class RecordedStampConverter:
    """Stamps are the recorded device's own."""

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        """See `StampConverter`."""
        return device_s


class FakenectSource:
    """Plays a folder once, from its beginning; its depth is taken for registered millimetres.

    fakenect keeps to the times in the names of the files. In lockstep it also waits for the reader.
    It ends the whole process where the folder is not as it should be: so that is checked before.
    """

    clock = Clock.RECORDED
    timeouts = StreamTimeouts(first_image_s=inf, next_image_s=inf)
    min_period_s = 0.0

    def __init__(
        self, folder: Path, playback_mode: PlaybackMode, library: Path | None = None
    ) -> None:
        """`library`: the file of fakenect, where it is not the system's."""
        self.name = f"fakenect:{folder}"
        self._folder, self._playback_mode, self._library = folder, playback_mode, library

    def load(self) -> ctypes.CDLL:
        """See `Source`. Loads a copy: fakenect cannot begin again in the same library."""
        check_dump_folder(self._folder)
        os.environ[PATH_VARIABLE] = str(self._folder.resolve())
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(self._library or _find_system_library(), folder)
            return load_library(str(copy))

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        """See `Source`."""
        with context.open_device("") as device:
            assert device is not None, "fakenect opens whatever it is asked for"
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """See `Source`: fakenect ends the process if it is asked for any other."""
        return DepthFormat.RAW_11_BIT

    def configure(self, device: FreenectDevice) -> DepthFilter:
        """See `Source`: fakenect has nothing to set and no table."""
        return ValidDepthMask(all_depths_to_10_m())

    def make_end_exception(self) -> Exception:
        """See `Source`."""
        return EndOfStream()

    def make_queue(self) -> FrameQueue:
        """See `Source`."""
        return (
            BlockingFrameQueue()
            if self._playback_mode is PlaybackMode.LOCKSTEP
            else LatestFrameQueue()
        )

    def make_stamp_converter(self) -> RecordedStampConverter:
        """See `Source`."""
        return RecordedStampConverter()


def _find_system_library() -> Path:
    found = sorted(SYSTEM_LIBRARY_FOLDER.glob(LIBRARY_PATTERN)) + sorted(
        SYSTEM_LIBRARY_FOLDER.glob(f"*/{LIBRARY_PATTERN}")
    )
    if not found:
        raise UserFacingError(f"fakenect is not installed: apt install {PACKAGE}")
    return found[0]
