"""A sensor's timing put into its camera file, of which all else stays as it is."""

from dataclasses import replace
from pathlib import Path

from drivers.calibration import CameraCalibration, format_calibration, read_calibration
from drivers.core.config import find_key_lines, parse_toml
from vo_service.tools.calibration.output_files import save_with_backup
from vo_service.tools.calibration.timing_cost import SensorTiming


def read_timing(path: Path, fallback: CameraCalibration) -> SensorTiming:
    """What a camera file says now; if there is none, what the other one says.

    Raises InputError if the file is wrong.
    """
    camera = read_calibration(path) if path.exists() else fallback
    return SensorTiming(camera.readout_s, camera.depth_offset_s)


def save_timing(
    path: Path, fallback: CameraCalibration, timing: SensorTiming, heading: str
) -> Path | None:
    """Put a timing into a camera file, or write one that is as the other otherwise.

    A file that was there is kept beside it, and its new name returned. Raises InputError if it is
    no camera file, UserFacingError if the disk refuses; the old one is then still in place.
    """
    camera = replace(fallback, readout_s=timing.readout_s, depth_offset_s=timing.depth_offset_s)
    text = f"# {heading}\n{format_calibration(camera)}"
    if path.exists():
        text = replace_timing(path.read_text(encoding="utf-8-sig"), timing)
        parse_toml(text, str(path), CameraCalibration)
    return save_with_backup(path, text.encode())


def replace_timing(text: str, timing: SensorTiming) -> str:
    """A camera file's text with its two keys for the timing changed, or put behind the first."""
    for key, value in (
        ("depth_offset_s", timing.depth_offset_s),
        ("readout_s", timing.readout_s),
    ):
        lines, numbers = text.split("\n"), find_key_lines(text)
        if (key,) in numbers:
            at = numbers[(key,)] - 1
            _, mark, comment = lines[at].partition("#")
            lines[at] = f"{key} = {value!r}" + (f"  {mark}{comment}" if mark else "")
        else:
            lines.insert(numbers[("schema",)], f"{key} = {value!r}")
        text = "\n".join(lines)
    return text
