"""Output files, written atomically and checked before the work."""

import os
from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration
from drivers.camera_yaml import YAML_SUFFIXES
from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write, is_disk_full


def check_writable(path: Path) -> None:
    """Raise InputError if the file cannot be written."""
    if path.suffix.lower() in YAML_SUFFIXES:
        raise InputError(f"{path}: camera files are written in TOML; name {path.stem}.toml")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written; name a writable folder")


def save_camera_file(path: Path, camera: CameraCalibration, heading: str) -> Path | None:
    """Write a camera file as `save_with_backup` does.

    Args:
        path: The camera file.
        camera: Its content.
        heading: Comment in its first line.
    """
    return save_with_backup(path, f"# {heading}\n{format_calibration(camera)}".encode())


def save_with_backup(path: Path, data: bytes) -> Path | None:
    """Write a file and keep an existing one as a backup.

    Returns:
        The path of the backup; None without an existing file.

    Raises:
        UserFacingError: The disk fails; the existing file is then unchanged.
    """
    path = path.resolve()
    backup = None
    try:
        if path.exists():
            backup = path.with_name(f"{path.name}.bak")
            atomic_write(backup, path.read_bytes())
        atomic_write(path, data)
    except OSError as error:
        raise _write_error(path, error) from error
    return backup


def save(path: Path, data: bytes) -> None:
    """Write a file.

    Raises:
        UserFacingError: If the disk fails.
    """
    try:
        atomic_write(path, data)
    except OSError as error:
        raise _write_error(path, error) from error


def _write_error(path: Path, error: OSError) -> UserFacingError:
    cause = "the disk is full" if is_disk_full(error) else error.strerror
    return UserFacingError(f"{path}: cannot be written: {cause}; fix this and calibrate again")
