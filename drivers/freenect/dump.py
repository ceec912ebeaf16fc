"""A recorded folder in libfreenect's own format, played by fakenect: another libfreenect."""

import ctypes
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

from drivers.camera import Clock, EndOfStream, Pace
from drivers.errors import UserFacingError
from drivers.freenect.context import Context, Device
from drivers.freenect.depth import DepthFilter, MeasuredOnly, up_to_10_m
from drivers.freenect.dump_folder import check_dump
from drivers.freenect.library import PACKAGE, DepthFormat, load_library
from drivers.freenect.mailbox import LockstepMailbox, Mailbox, NewestMailbox
from drivers.freenect.watchdog import Patience

FOLDER_VARIABLE = "FAKENECT_PATH"
SYSTEM = Path("/usr/lib")
LIBRARY = "fakenect/libfreenect.so.0.5"


class RecordedTime:
    """Stamps are the recorded device's own."""

    def host_s(self, device_s: float, arrival_s: float) -> float:
        """See `StampMap`."""
        return device_s


class Dump:
    """Plays a folder once, from its beginning; its depth is taken for registered millimetres.

    fakenect keeps to the times in the names of the files. In lockstep it also waits for the reader.
    It ends the whole process where the folder is not as it should be: so that is checked before.
    """

    clock = Clock.RECORDED
    patience = Patience(first_s=inf, next_s=inf)
    shortest_period_s = 0.0

    def __init__(self, folder: Path, pace: Pace, library: Path | None = None) -> None:
        """`library`: the file of fakenect, where it is not the system's."""
        self.name = f"fakenect:{folder}"
        self._folder, self._pace, self._library = folder, pace, library

    def load(self) -> ctypes.CDLL:
        """See `Source`. Loads a copy: fakenect cannot begin again in the same library."""
        check_dump(self._folder)
        os.environ[FOLDER_VARIABLE] = str(self._folder.resolve())
        with tempfile.TemporaryDirectory() as folder:
            copy = shutil.copy(self._library or _system_library(), folder)
            return load_library(str(copy))

    @contextmanager
    def open(self, context: Context) -> Iterator[Device]:
        """See `Source`."""
        with context.device("") as device:
            assert device is not None, "fakenect opens whatever it is asked for"
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """See `Source`: fakenect ends the process if it is asked for any other."""
        return DepthFormat.RAW_11_BIT

    def set_up(self, device: Device) -> DepthFilter:
        """See `Source`: fakenect has nothing to set and no table."""
        return MeasuredOnly(up_to_10_m())

    def end(self) -> Exception:
        """See `Source`."""
        return EndOfStream()

    def mailbox(self) -> Mailbox:
        """See `Source`."""
        return LockstepMailbox() if self._pace is Pace.LOCKSTEP else NewestMailbox()

    def stamp_map(self) -> RecordedTime:
        """See `Source`."""
        return RecordedTime()


def _system_library() -> Path:
    found = sorted(SYSTEM.glob(LIBRARY)) + sorted(SYSTEM.glob(f"*/{LIBRARY}"))
    if not found:
        raise UserFacingError(f"fakenect is not installed: apt install {PACKAGE}")
    return found[0]
