"""Writing of files: atomic writes, append-only files, rotation."""

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.core import InputError
from drivers.core.write_errors import check_in_place, writing

MEGABYTE = 1_000_000
# Suffix of incomplete files and folders.
PARTIAL_SUFFIX = ".part"


def check_suffix(path: Path, suffixes: Sequence[str]) -> str:
    """Return the suffix of a file to be written, in lower case. Raises InputError."""
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise InputError(f"{path}: the file name must end in {' or '.join(suffixes)}")
    return suffix


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name; what is written there gets the name `path` at the end of the block.

    So no reader sees half a file, and a kill at any moment is safe. After an exception nothing is
    left behind. The data are not flushed to the disk: after a power cut the newest files may be
    empty, unless the block flushes them.

    Raises:
        WriteError: The block or the renaming raises an OSError.
    """
    part = path.with_name(f".{path.name}{PARTIAL_SUFFIX}")
    try:
        with writing(path):
            yield part
            part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def atomic_write(path: Path, data: bytes) -> None:
    """Write a whole file; see `atomic_file`. Raises WriteError."""
    with atomic_file(path) as part:
        part.write_bytes(data)


class AppendOnlyFile:
    """A text file that grows by whole lines only."""

    def __init__(self, path: Path, header: str) -> None:
        """Create the file with `header` as a comment in its first line. Raises OSError."""
        self.path = path
        self._size = 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        try:
            self.append(f"# {header}")
        except OSError:
            self.close()
            path.unlink(missing_ok=True)
            raise

    def append(self, line: str) -> None:
        """Append one line. Raises OSError and leaves the file unchanged if that fails."""
        data = f"{line}\n".encode()
        try:
            check_in_place(self._fd, self.path)
            # One call writes the whole line, so a kill cannot split it; only a full disk can.
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError:
            os.ftruncate(self._fd, self._size)
            raise
        self._size = os.fstat(self._fd).st_size

    @property
    def is_in_place(self) -> bool:
        """Whether the file is still at its path."""
        try:
            check_in_place(self._fd, self.path)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the file; nothing is buffered."""
        os.close(self._fd)


class LateFile:
    """An `AppendOnlyFile` that is created with its first line."""

    def __init__(self, path: Path, header: str) -> None:
        self._path, self._header = path, header
        self._file: AppendOnlyFile | None = None

    def append(self, line: str) -> None:
        """Append one line. Raises OSError."""
        self._file = self._file or AppendOnlyFile(self._path, self._header)
        self._file.append(line)

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        file, self._file = self._file, None
        if file is not None:
            file.close()


def check_writable(folder: Path) -> str:
    """Return why a folder cannot be written to, or "" if it can.

    The folder need not exist. Nothing is created or written.
    """
    for ancestor in (folder, *folder.absolute().parents):
        try:
            is_folder = stat.S_ISDIR(ancestor.stat().st_mode)
        except FileNotFoundError:
            continue
        except OSError as error:
            return f"{folder}: cannot be used: {error.strerror}"
        if not is_folder:
            return f"{folder}: cannot be used: {ancestor} is not a folder"
        if not os.access(ancestor, os.R_OK | os.W_OK | os.X_OK):
            return f"{folder}: cannot be used: no permission to write to {ancestor}"
        return ""
    return f"{folder}: cannot be used"


@contextmanager
def lock_folder(folder: Path, *, waits: bool = False) -> Iterator[None]:
    """Hold the lock of a folder.

    Raises:
        BlockingIOError: Another process holds it, and `waits` is false.
    """
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
        yield
    finally:
        os.close(fd)


@contextmanager
def partial_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder PATH.part that is locked; it is removed at the end, unless renamed.

    The lock keeps another process from removing it as left behind. Raises OSError.
    """
    part = path.with_name(path.name + PARTIAL_SUFFIX)
    part.mkdir(mode=0o700)
    try:
        with lock_folder(part):
            yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def remove_partial_folders(parts: Iterable[Path]) -> None:
    """Remove the partial folders of processes that were killed."""
    for part in parts:
        with suppress(OSError), lock_folder(part):
            shutil.rmtree(part, ignore_errors=True)


def folder_size_bytes(folder: Path) -> int:
    """Return the bytes of all files below a folder; files that disappear meanwhile are skipped."""
    total = 0
    for subfolder, _, files in os.walk(folder):
        for name in files:
            with suppress(OSError):
                total += (Path(subfolder) / name).lstat().st_size
    return total


def rotate_file(path: Path, max_files: int) -> None:
    """Rename an existing file to FILE-NNNN and delete the oldest, so that `max_files` remain.

    The limit includes the new file. A higher number is newer. Raises OSError.
    """
    numbers = sorted(_rotation_numbers(path))
    if path.is_file():
        numbers.append(numbers[-1] + 1 if numbers else 1)
        path.rename(_rotated_path(path, numbers[-1]))
    for number in numbers[: max(0, len(numbers) - max_files + 1)]:
        _rotated_path(path, number).unlink()


def _rotation_numbers(path: Path) -> list[int]:
    pattern = re.compile(re.escape(path.stem) + r"-(\d{4,})" + re.escape(path.suffix))
    matches = (pattern.fullmatch(file.name) for file in path.parent.iterdir() if file.is_file())
    return [int(match[1]) for match in matches if match]


def _rotated_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number:04d}{path.suffix}")
