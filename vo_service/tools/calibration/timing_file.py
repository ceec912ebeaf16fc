"""Change of a sensor's timing in its camera file."""

from dataclasses import replace
from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration, read_calibration
from drivers.core.config import find_key_lines, parse_toml
from vo_service.tools.calibration.output_files import save_with_backup
from vo_service.tools.calibration.timing_cost import SensorTiming


def read_timing(path: Path, fallback: CameraCalibration) -> SensorTiming:
    """Return the timing of a camera file, or of `fallback` if the file does not exist.

    Raises:
        InputError: The file is invalid.
    """
    camera = read_calibration(path) if path.exists() else fallback
    return SensorTiming(camera.readout_s, camera.depth_offset_s)


def save_timing(
    path: Path, fallback: CameraCalibration, timing: SensorTiming, heading: str
) -> Path | None:
    """Change the timing in a camera file, or write a new file.

    Args:
        path: The camera file.
        fallback: Contents of a new file, except for the timing.
        timing: The timing.
        heading: Comment at the top of a new file.

    Returns:
        The path of the backup of an existing file; None without one.

    Raises:
        InputError: The existing file is not a camera file.
        UserFacingError: The disk fails; the existing file is then unchanged.
    """
    camera = replace(fallback, readout_s=timing.readout_s, depth_offset_s=timing.depth_offset_s)
    text = f"# {heading}\n{format_calibration(camera)}"
    if path.exists():
        text = replace_timing(path.read_text(encoding="utf-8-sig"), timing)
        parse_toml(text, str(path), CameraCalibration)
    return save_with_backup(path, text.encode())


def replace_timing(text: str, timing: SensorTiming) -> str:
    """Return a camera file's text with the timing's keys changed, or inserted after `schema`."""
    for key, value in (
        ("depth_offset_s", timing.depth_offset_s),
        ("readout_s", timing.readout_s),
    ):
        lines, numbers = text.split("\n"), find_key_lines(text)
        if (key,) in numbers:
            index = numbers[(key,)] - 1
            _, comment_sign, comment = lines[index].partition("#")
            lines[index] = f"{key} = {value!r}" + (
                f"  {comment_sign}{comment}" if comment_sign else ""
            )
        else:
            lines.insert(numbers[("schema",)], f"{key} = {value!r}")
        text = "\n".join(lines)
    return text
