"""Output files, written atomically, with a backup of an existing one."""

from itertools import count
from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration
from drivers.camera_yaml import YAML_SUFFIXES
from drivers.core import InputError
from drivers.core.files import atomic_write
from drivers.core.input_files import read_input
from drivers.core.write_errors import check_output_file


def check_camera_output(path: Path) -> None:
    """Raise UserFacingError if no camera file can be written there."""
    if path.suffix.lower() in YAML_SUFFIXES:
        raise InputError(f"{path}: camera files are written in TOML; name {path.stem}.toml")
    check_output_file(path)


def save_camera_file(path: Path, camera: CameraCalibration, heading: str) -> Path | None:
    """Write a camera file with a heading, a comment, as `save_with_backup` does."""
    return save_with_backup(path, f"# {heading}\n{format_calibration(camera)}".encode())


def save_with_backup(path: Path, data: bytes) -> Path | None:
    """Write a file and keep an existing one as a backup, beside earlier ones.

    Returns:
        The path of the backup; None without an existing file.

    Raises:
        WriteError: The existing file is then unchanged.
    """
    path = path.resolve()
    backup = None
    if path.exists():
        backup = _unused_backup(path)
        atomic_write(backup, read_input(path))
    atomic_write(path, data)
    return backup


def _unused_backup(path: Path) -> Path:
    """Return FILE.bak, or FILE.bak2 and so on if there are backups already."""
    names = (f"{path.name}.bak{'' if number == 1 else number}" for number in count(1))
    return next(backup for name in names if not (backup := path.with_name(name)).exists())
