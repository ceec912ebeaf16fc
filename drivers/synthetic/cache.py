"""Rendered films on disk, to be rendered only once.

A film is KEY.npy, an array of (colour, depth), which appears under its name only when whole. It
counts with KEY.json, which holds its checksum and is written last.

What is being rendered is a locked .part; one that nobody holds was left by a killed process.
"""

import fcntl
import json
import os
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CameraError, InputError

Film = NDArray[np.void]  # (N,) records of `colour` and `depth`
LARGEST_CACHE_BYTES = 4 << 30


class FilmCache:
    """Films in a folder, the longest unused removed first when it grows beyond `largest_bytes`."""

    def __init__(self, folder: Path, largest_bytes: int = LARGEST_CACHE_BYTES) -> None:
        self._folder = folder
        self._largest_bytes = largest_bytes

    def load(self, key: str, frames: int, dtype: np.dtype[np.void]) -> Film | None:
        """The film of that key, or None if there is none or it is damaged."""
        path, note = self._folder / f"{key}.npy", self._folder / f"{key}.json"
        try:
            expected = json.loads(note.read_text())["crc32"]
            film: Film = np.load(path, mmap_mode="r")
            if film.dtype != dtype or film.shape != (frames,) or _checksum(film) != expected:
                return None
            os.utime(path)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return film

    def make(
        self,
        key: str,
        frames: int,
        dtype: np.dtype[np.void],
        fill_film: Callable[[Film], None],
    ) -> Film:
        """Render a film into the folder and open it.

        Raises InputError if the folder cannot be written, CameraError if the disk is full.
        """
        size = frames * dtype.itemsize
        part = self._folder / f"{key}.{os.getpid()}.{threading.get_native_id()}.part"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with ExitStack() as held:
                with _locked(self._folder):  # nobody takes a part for left before it is locked
                    self._make_room(size)
                    held.enter_context(_locked(part, os.O_CREAT))
                    held.callback(part.unlink, missing_ok=True)
                    _reserve(part, frames, dtype)
                film = np.lib.format.open_memmap(part, mode="r+")
                fill_film(film)
                film.flush()
                part.replace(self._folder / f"{key}.npy")
            note = json.dumps({"crc32": _checksum(film)})
            (self._folder / f"{key}.json").write_text(note)
        except (PermissionError, NotADirectoryError, FileExistsError) as error:
            raise InputError(
                f"{self._folder}: frames cannot be kept there: {error.strerror}"
            ) from error
        except OSError as error:
            raise CameraError(
                f"{self._folder}: cannot keep {size / 1e6:.0f} MB of frames: {error.strerror}; "
                "free some space or ask for a shorter duration"
            ) from error
        readable: Film = np.load(self._folder / f"{key}.npy", mmap_mode="r")
        return readable

    def _make_room(self, size: int) -> None:
        self._remove_left_parts()
        size += sum(_size(part) for part in self._folder.glob("*.part"))
        films = sorted(self._folder.glob("*.npy"), key=lambda path: path.stat().st_mtime)
        total = size + sum(path.stat().st_size for path in films)
        for path in films:
            if total <= self._largest_bytes:
                return
            total -= path.stat().st_size
            # Another process may be playing it: an open file stays readable after this.
            path.unlink(missing_ok=True)
            path.with_suffix(".json").unlink(missing_ok=True)

    def _remove_left_parts(self) -> None:
        for part in self._folder.glob("*.part"):
            with suppress(OSError), _locked(part, block=False):
                part.unlink()


@contextmanager
def _locked(path: Path, flags: int = 0, *, block: bool = True) -> Iterator[None]:
    """Hold the lock of a file or folder. Raises BlockingIOError if another has it."""
    fd = os.open(path, os.O_RDONLY | flags, 0o666)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | (0 if block else fcntl.LOCK_NB))
        yield
    finally:
        os.close(fd)


def _size(path: Path) -> int:
    """Bytes of a file; of one that has just got its name, none."""
    with suppress(OSError):
        return path.stat().st_size
    return 0


def _reserve(path: Path, frames: int, dtype: np.dtype[np.void]) -> None:
    """Take the disk space now: a full disk under a memory map would kill the process."""
    film = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=(frames,))
    del film
    with path.open("r+b") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)


def _checksum(film: Film) -> int:
    total = 0
    for index in range(len(film)):
        total = zlib.crc32(film[index].tobytes(), total)
    return total
