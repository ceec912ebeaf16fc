"""Change of a sensor's timing in its camera file."""

from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration, read_calibration
from drivers.core.config import find_key_lines, parse_toml
from vo_service.tools.calibration.output_files import save_with_backup
from vo_service.tools.calibration.timing import SensorTiming


def read_camera(path: Path, fallback: CameraCalibration) -> CameraCalibration:
    """Read a camera file; return `fallback` if it does not exist.

    Raises:
        InputError: The file is invalid.
    """
    return read_calibration(path) if path.exists() else fallback


def save_timing(
    path: Path, fallback: CameraCalibration, changes: SensorTiming, heading: str
) -> Path | None:
    """Change the timing in a camera file, or write a new file.

    Args:
        path: The camera file.
        fallback: Contents of a new file, except for the timing.
        changes: The values to change, with their standard deviations.
        heading: Comment at the top of a new file.

    Returns:
        The path of the backup of an existing file; None without one.

    Raises:
        InputError: The existing file is not a camera file.
        UserFacingError: The disk fails; the existing file is then unchanged.
    """
    before = (
        path.read_text(encoding="utf-8-sig")
        if path.exists()
        else f"# {heading}\n{format_calibration(fallback)}"
    )
    text = replace_timing(before, changes)
    parse_toml(text, str(path), CameraCalibration)
    return save_with_backup(path, text.encode())


def replace_timing(text: str, changes: SensorTiming) -> str:
    """Return a camera file's text with these keys changed, or inserted after `schema`."""
    for key, value_s in reversed(_file_values(changes).items()):
        lines, numbers = text.split("\n"), find_key_lines(text)
        if (key,) in numbers:
            index = numbers[(key,)] - 1
            _, comment_sign, comment = lines[index].partition("#")
            lines[index] = f"{key} = {value_s!r}" + (
                f"  {comment_sign}{comment}" if comment_sign else ""
            )
        else:
            lines.insert(numbers[("schema",)], f"{key} = {value_s!r}")
        text = "\n".join(lines)
    return text


def _file_values(changes: SensorTiming) -> dict[str, float]:
    """Return the values by key of the camera file, each followed by its standard deviation."""
    values: dict[str, float] = {}
    for key, value in changes.items():
        values[key] = value.value_s
        values[f"{key.removesuffix('_s')}_sigma_s"] = value.sigma_s
    return values
