"""Rendered films on disk, to be rendered only once.

A film is KEY.npy, an array of (colour, depth), beside KEY.json, which holds its checksum and is
written last. Both appear under their names only when whole.
"""

import contextlib
import json
import os
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CameraError, InputError

Film = NDArray[np.void]  # (N,) records of `colour` and `depth`
LARGEST_CACHE_BYTES = 4 << 30
STALE_PART_S = 24 * 3600.0


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
        part = self._folder / f"{key}.{os.getpid()}.part"
        note = part.with_suffix(".note.part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._make_room(size)
            _reserve(part, frames, dtype)
            film = np.lib.format.open_memmap(part, mode="r+")
            fill_film(film)
            film.flush()
            note.write_text(json.dumps({"crc32": _checksum(film)}))
            part.replace(self._folder / f"{key}.npy")
            note.replace(self._folder / f"{key}.json")
        except (PermissionError, NotADirectoryError, FileExistsError) as error:
            raise InputError(
                f"{self._folder}: frames cannot be kept there: {error.strerror}"
            ) from error
        except OSError as error:
            raise CameraError(
                f"{self._folder}: cannot keep {size / 1e6:.0f} MB of frames: {error.strerror}; "
                "free some space or ask for a shorter duration"
            ) from error
        finally:
            for leftover in (part, note):
                with contextlib.suppress(OSError):
                    leftover.unlink()
        readable: Film = np.load(self._folder / f"{key}.npy", mmap_mode="r")
        return readable

    def _make_room(self, size: int) -> None:
        now = time.time()
        for part in self._folder.glob("*.part"):
            if now - part.stat().st_mtime > STALE_PART_S:
                part.unlink(missing_ok=True)
        films = sorted(self._folder.glob("*.npy"), key=lambda path: path.stat().st_mtime)
        total = size + sum(path.stat().st_size for path in films)
        for path in films:
            if total <= self._largest_bytes:
                return
            total -= path.stat().st_size
            # Another process may be playing it: an open file stays readable after this.
            path.unlink(missing_ok=True)
            path.with_suffix(".json").unlink(missing_ok=True)


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
