"""Sinks that fail in the viewer's process."""

import errno
import mmap
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.write_errors import WriteError
from vo_service.outputs.rerun.sinks import LiveSink

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb


class _InMemorySink(LiveSink):
    """Sink that stores all data in memory."""

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Store the data in memory."""
        self._memory = stream.memory_recording()


class BlockingSink(_InMemorySink):
    """A viewer that reads no data: Rerun blocks forever."""

    address = "blocked"

    def check(self, stream: "rr.RecordingStream") -> None:
        """Block forever."""
        threading.Event().wait()


class LeakingSink(_InMemorySink):
    """A sink that leaks some megabytes for each image."""

    address = "glutton"

    def __init__(self, mb: int) -> None:
        self._mb = mb
        self._leaked: list[bytes] = []

    def check(self, stream: "rr.RecordingStream") -> None:
        """Allocate memory and write to all of it."""
        self._leaked.append(b"x" * (self._mb * 1_000_000))


class FileReadingSink(_InMemorySink):
    """A sink that maps a file of some megabytes, as libraries are, and reads all of it."""

    address = "file"

    def __init__(self, file: Path, mb: int) -> None:
        self._file, self._mb = file, mb
        self._mapped: list[mmap.mmap] = []

    def check(self, stream: "rr.RecordingStream") -> None:
        """Map and read the file, once."""
        if not self._mapped:
            self._file.write_bytes(bytes(self._mb * 1_000_000))
            with self._file.open("rb") as file:
                self._mapped.append(mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ))
            sum(self._mapped[0][:: mmap.PAGESIZE])


class FullDiskSink(_InMemorySink):
    """A disk that is full after the first image."""

    address = "full"

    def check(self, stream: "rr.RecordingStream") -> None:
        """Raise the error of a full disk."""
        raise WriteError.of(Path("full"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
