"""Files that appear whole or not at all, and say beforehand if they cannot."""

import os
from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration
from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import atomic_write, is_disk_full


def check_writable(path: Path) -> None:
    """Raise InputError if a file cannot be written there: before the work, not after it."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written; name a folder that you may write to")


def save_camera_file(path: Path, camera: CameraCalibration, heading: str) -> Path | None:
    """Write it; as `save_with_backup`."""
    return save_with_backup(path, f"# {heading}\n{format_calibration(camera)}".encode())


def save_with_backup(path: Path, data: bytes) -> Path | None:
    """Write a file; one that was there is kept beside it, and its new name returned.

    Raises UserFacingError if the disk refuses; the old file is then still in place.
    """
    path = path.resolve()
    kept = None
    try:
        if path.exists():
            kept = path.with_name(f"{path.name}.bak")
            atomic_write(kept, path.read_bytes())
        atomic_write(path, data)
    except OSError as error:
        raise _write_error(path, error) from error
    return kept


def save(path: Path, data: bytes) -> None:
    """Write a file. Raises UserFacingError if the disk refuses."""
    try:
        atomic_write(path, data)
    except OSError as error:
        raise _write_error(path, error) from error


def _write_error(path: Path, error: OSError) -> UserFacingError:
    cause = "the disk is full" if is_disk_full(error) else error.strerror
    return UserFacingError(f"{path}: cannot be written: {cause}; mend that and calibrate again")
