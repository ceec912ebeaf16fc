"""Where the program keeps things: what it can make again, and what it cannot."""

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError

SOURCE_PACKAGES = ("drivers", "vo_service")
# Below the environment's prefix: what set-up has compiled for all who use the environment.
PREBUILT_KERNELS = "share/kinect-vo/kernels"
# Several checkouts and versions may share a computer.
MAX_KERNEL_FOLDERS = 4


def cache_folder() -> Path:
    """A writable folder of our own; systemd's, the user's, or in the last resort a temporary one.

    The first of $CACHE_DIRECTORY (systemd), $XDG_CACHE_HOME/kinect-vo, ~/.cache/kinect-vo and
    $TMPDIR/kinect-vo-UID that can be written to. Raises UserFacingError if none can.
    """
    for folder in _candidate_folders("CACHE_DIRECTORY", "XDG_CACHE_HOME", ".cache"):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    with suppress(OSError):
        return _temporary_folder()
    raise UserFacingError(
        "no folder can be written to for what is worth keeping (compiled kernels); name one in "
        "XDG_CACHE_HOME"
    )


def state_folder() -> Path:
    """A writable folder of our own for what cannot be made again: incidents, recordings.

    The first of $STATE_DIRECTORY (systemd), $XDG_STATE_HOME/kinect-vo and ~/.local/state/kinect-vo
    that can be written to. Raises UserFacingError if none can.
    """
    for folder in _candidate_folders("STATE_DIRECTORY", "XDG_STATE_HOME", ".local/state"):
        with suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    raise UserFacingError(
        "no folder can be written to for what is to be kept (incidents, recordings); name one in "
        "XDG_STATE_HOME"
    )


def create_output_folder(folder: Path) -> None:
    """Make the folder that --output names, if it is not there. Raises InputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be created: {error.strerror}; name another with --output"
        ) from error


def kernel_folder() -> Path:
    """Where compiled kernels of this very source are kept; those of older sources are removed.

    Numba's own cache looks at a kernel's file alone: it would go on using the old code of a helper
    that was inlined from another file. So each state of the source has a folder of its own. Where
    set-up has compiled kernels into the Python environment, the folder begins with a copy of them:
    the environment may belong to another user.
    """
    kernels, state = cache_folder() / "kernels", _source_digest()
    folder = kernels / state
    with suppress(OSError):
        if not folder.exists():
            _copy_atomically(Path(sys.prefix) / PREBUILT_KERNELS / state, folder)
        folder.mkdir(parents=True, exist_ok=True)
        folder.touch()
        kept = sorted(kernels.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in kept[MAX_KERNEL_FOLDERS:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


def _copy_atomically(source: Path, folder: Path) -> None:
    """Copy a folder that may not exist; `folder` appears when all of it is there."""
    if source.is_dir():
        part = folder.with_name(f"{folder.name}.{os.getpid()}.part")
        try:
            shutil.copytree(source, part)
            part.rename(folder)  # fails if another process was quicker
        finally:
            shutil.rmtree(part, ignore_errors=True)


def _source_digest() -> str:
    digest = hashlib.sha256()
    for package in SOURCE_PACKAGES:
        for source in sorted((Path(__file__).parents[2] / package).rglob("*.py")):
            state = source.stat()
            digest.update(f"{source} {state.st_mtime_ns} {state.st_size}\n".encode())
    return digest.hexdigest()[:16]


def _candidate_folders(systemd_variable: str, xdg_variable: str, below_home: str) -> list[Path]:
    """Systemd's folder, the user's choice, the usual one: as far as there are any."""
    given = os.environ.get(systemd_variable, "").split(":")[0]
    folders = [Path(given)] if given else []
    chosen = os.environ.get(xdg_variable)
    if chosen:
        folders.append(Path(chosen) / "kinect-vo")
    with suppress(RuntimeError):  # a user without a home
        folders.append(Path.home() / below_home / "kinect-vo")
    return folders


def _temporary_folder() -> Path:
    """One for each user, the same every time. Raises OSError unless it is this user's alone.

    Anybody may make a folder of that name first, and what lies in it is run.
    """
    folder = Path(tempfile.gettempdir()) / f"kinect-vo-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    state = folder.lstat()
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != os.getuid() or state.st_mode & 0o077:
        raise PermissionError(f"{folder}: is not this user's alone")
    return folder
