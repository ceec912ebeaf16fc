"""Files and folders: where they belong, atomic writes, append-only files, rotation."""

import fcntl
import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.core import InputError, UserFacingError
from drivers.core.write_errors import check_in_place, writing

MEGABYTE = 1_000_000
SOURCE_PACKAGES = ("drivers", "vo_service")
# The files of compiled kernels, and those that they import: a change elsewhere compiles nothing.
KERNEL_SOURCES = (
    "drivers/camera.py",
    "drivers/core",
    "drivers/synthetic",
    "vo_service/frame_record.py",
    "vo_service/odometry",
    "vo_service/reconstruction",
    "vo_service/slam/keyframe_database.py",
    "vo_service/types",
)
# Below the environment's prefix: kernels that setup has compiled for all users.
PREBUILT_KERNELS = "share/kinect-vo/kernels"
# One folder per state of the source: several checkouts and versions may share a computer.
MAX_KERNEL_FOLDERS = 4
# A folder that was used more recently may belong to a running process, which still compiles.
MIN_UNUSED_S = 86_400.0
# Suffix of incomplete files and folders.
PARTIAL_SUFFIX = ".part"


def cache_folder() -> Path:
    """Return a writable folder for files that can be made again.

    It is the first writable one of $CACHE_DIRECTORY (systemd), $XDG_CACHE_HOME/kinect-vo,
    ~/.cache/kinect-vo and $TMPDIR/kinect-vo-UID.

    Raises:
        UserFacingError: None of them is writable.
    """
    for folder in _candidate_folders("CACHE_DIRECTORY", "XDG_CACHE_HOME", ".cache"):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    with suppress(OSError):
        return _temporary_folder()
    raise UserFacingError(
        "no folder is writable for the cache (compiled kernels); set XDG_CACHE_HOME to a writable "
        "folder"
    )


def state_folder() -> Path:
    """Return a writable folder for files that cannot be made again: incidents, recordings.

    It is the first writable one of $STATE_DIRECTORY (systemd), $XDG_STATE_HOME/kinect-vo and
    ~/.local/state/kinect-vo.

    Raises:
        UserFacingError: None of them is writable.
    """
    for folder in _candidate_folders("STATE_DIRECTORY", "XDG_STATE_HOME", ".local/state"):
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    raise UserFacingError(
        "no folder is writable for incidents and recordings; set XDG_STATE_HOME to a writable "
        "folder"
    )


def check_suffix(path: Path, suffixes: Sequence[str]) -> str:
    """Return the suffix of a file to be written, in lower case.

    Raises:
        InputError: It is none of `suffixes`.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise InputError(f"{path}: the file name must end in {' or '.join(suffixes)}")
    return suffix


def kernel_folder() -> Path:
    """Return the folder for compiled kernels of this state of their source; old ones are removed.

    Numba's cache checks only a kernel's own file: it would keep the old code of a helper inlined
    from another file. So each state of `KERNEL_SOURCES` has its own folder. It starts as a copy of
    the kernels that setup has compiled into the Python environment, if any: that environment may
    belong to another user.
    """
    kernels, digest = cache_folder() / "kernels", _source_digest()
    folder = kernels / digest
    with suppress(OSError):
        if not folder.exists():
            _copy_atomically(Path(sys.prefix) / PREBUILT_KERNELS / digest, folder)
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        newest_first = sorted(
            kernels.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True
        )
        for old in newest_first[MAX_KERNEL_FOLDERS:]:
            if time.time() - old.stat().st_mtime > MIN_UNUSED_S:
                shutil.rmtree(old, ignore_errors=True)
    return folder


def _copy_atomically(source: Path, folder: Path) -> None:
    """Copy a folder if it exists; `folder` appears only when the copy is complete."""
    if source.is_dir():
        part = folder.with_name(f"{folder.name}.{os.getpid()}.part")
        try:
            shutil.copytree(source, part)
            part.rename(folder)  # fails if another process was faster
        finally:
            shutil.rmtree(part, ignore_errors=True)


def _source_digest() -> str:
    digest = hashlib.sha256()
    for name in KERNEL_SOURCES:
        path = Path(__file__).parents[2] / name
        for source in [path] if path.is_file() else sorted(path.rglob("*.py")):
            status = source.stat()
            digest.update(f"{source} {status.st_mtime_ns} {status.st_size}\n".encode())
    return digest.hexdigest()[:16]


def _candidate_folders(systemd_variable: str, xdg_variable: str, below_home: str) -> list[Path]:
    """List systemd's folder, the user's (XDG) and the default one, as far as they exist."""
    systemd_folder = os.environ.get(systemd_variable, "").split(":")[0]
    folders = [Path(systemd_folder)] if systemd_folder else []
    xdg_folder = os.environ.get(xdg_variable)
    if xdg_folder:
        folders.append(Path(xdg_folder) / "kinect-vo")
    with suppress(RuntimeError):  # a user without a home
        folders.append(Path.home() / below_home / "kinect-vo")
    return folders


def _temporary_folder() -> Path:
    """Return this user's temporary folder. Raises OSError if others can write to it.

    Code in this folder is executed, and anybody may have created a folder of that name.
    """
    folder = Path(tempfile.gettempdir()) / f"kinect-vo-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{folder}: other users have access to it")
    return folder


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
        """Create the file with `header` as a comment in its first line.

        Raises:
            OSError: If that fails; no file is left.
        """
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
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder.

    Raises:
        BlockingIOError: If another process holds it.
    """
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(fd)


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
