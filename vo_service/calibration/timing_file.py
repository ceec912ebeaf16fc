"""A sensor's timing put into its camera file, of which all else stays as it is."""

from dataclasses import replace
from pathlib import Path

from drivers.camera_file import CameraFile, camera_file_text, read_camera_file
from drivers.strict_toml import parse_toml
from drivers.toml_lines import key_lines
from vo_service.calibration.saving import save_keeping
from vo_service.calibration.timing_cost import Timing


def timing_of(path: Path, otherwise: CameraFile) -> Timing:
    """What a camera file says now; if there is none, what the other one says.

    Raises InputError if the file is wrong.
    """
    camera = read_camera_file(path) if path.exists() else otherwise
    return Timing(camera.readout_s, camera.depth_offset_s)


def save_timing(path: Path, otherwise: CameraFile, timing: Timing, heading: str) -> Path | None:
    """Put a timing into a camera file, or write one that is as the other otherwise.

    A file that was there is kept beside it, and its new name returned. Raises InputError if it is
    no camera file, UserFacingError if the disk refuses; the old one is then still in place.
    """
    camera = replace(otherwise, readout_s=timing.readout_s, depth_offset_s=timing.depth_offset_s)
    text = f"# {heading}\n{camera_file_text(camera)}"
    if path.exists():
        text = with_timing(path.read_text(encoding="utf-8-sig"), timing)
        parse_toml(text, str(path), CameraFile)
    return save_keeping(path, text.encode())


def with_timing(text: str, timing: Timing) -> str:
    """A camera file's text with its two keys for the timing changed, or put behind the first."""
    for key, value in (
        ("depth_offset_s", timing.depth_offset_s),
        ("readout_s", timing.readout_s),
    ):
        lines, numbers = text.split("\n"), key_lines(text)
        if (key,) in numbers:
            at = numbers[(key,)] - 1
            _, mark, comment = lines[at].partition("#")
            lines[at] = f"{key} = {value!r}" + (f"  {mark}{comment}" if mark else "")
        else:
            lines.insert(numbers[("schema",)], f"{key} = {value!r}")
        text = "\n".join(lines)
    return text
