"""Folders of the program: for its cache, its state, and compiled kernels."""

import hashlib
import os
import shutil
import stat
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.processor import processor_identity

SOURCE_PACKAGES = ("drivers", "vo_service")
# The files of compiled kernels, and those that they import: a change elsewhere compiles nothing.
KERNEL_SOURCES = (
    "drivers/camera.py",
    "drivers/core",
    "drivers/freenect/bayer.py",
    "drivers/freenect/depth_tables.py",
    "drivers/freenect/raw_depth.py",
    "drivers/recording/image_encoding.py",
    "drivers/recording/odometry.py",
    "drivers/synthetic",
    "vo_service/frame_packing.py",
    "vo_service/figures.py",
    "vo_service/frame_record.py",
    "vo_service/navigation",
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


def kernel_folder() -> Path:
    """Return the folder for compiled kernels of this state of their source; old ones are removed.

    Numba's cache checks only a kernel's own file: it would keep the old code of a helper inlined
    from another file. So each state of `KERNEL_SOURCES` has its own folder, and each processor. It
    starts as a copy of the kernels that setup has compiled into the Python environment, if any:
    that environment may belong to another user.
    """
    kernels, digest = cache_folder() / "kernels", _kernel_digest()
    folder = kernels / digest
    with suppress(OSError):
        if not folder.exists():
            _copy_atomically(prebuilt_kernels() / digest, folder)
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


def prebuilt_kernels() -> Path:
    """Return the folder below the environment's prefix for the kernels of all users."""
    return Path(sys.prefix) / PREBUILT_KERNELS


def _kernel_digest() -> str:
    """Return a digest of the kernels' source, its place (Numba looks there), and the processor."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256(f"{root} {processor_identity()}".encode())
    for name in KERNEL_SOURCES:
        path = root / name
        for source in [path] if path.is_file() else sorted(path.rglob("*.py")):
            digest.update(f"{source} ".encode() + source.read_bytes())
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
