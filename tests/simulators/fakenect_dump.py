"""Writes recordings in the layout of libfreenect's ``fakenect``."""

import struct
from collections.abc import Iterable
from pathlib import Path

from tests.simulators.usb_frames import COLUMNS, ROWS, ColorBgr, DepthMm

TICKS_PER_S = 60_000_000
INDEX = "INDEX.txt"
LEVEL = (0, 819, 0)  # counts of the accelerometer, 819 per g
# x, y, z counts, twice the angle in degrees, and a status: the C structure with its padding.
_TILT_STATE = "<hhhbxi"


def write_fakenect_dump(
    folder: Path,
    frames: Iterable[tuple[ColorBgr, DepthMm]],
    rate_hz: float = 30.0,
    start_ticks: int = 0,
    color_offset_s: float = 0.0,
) -> None:
    """Write frames, each with an accelerometer reading before it.

    Args:
        folder: Folder of the recording.
        frames: Color (480, 640, 3) uint8 BGR, and depth (480, 640) uint16. fakenect does not
            convert depth, so it may be millimeters.
        rate_hz: Frames per second; the host times in the file names set the playback speed.
        start_ticks: First value of the camera's 60 MHz clock, 32 bits.
        color_offset_s: How much later than depth a color frame is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names: list[str] = []
    for number, (bgr, depth) in enumerate(frames):
        depth_s = number / rate_hz
        color_s = depth_s + color_offset_s
        files = {
            _name("a", depth_s, start_ticks, "dump"): struct.pack(_TILT_STATE, *LEVEL, 0, 0),
            _name("d", depth_s, start_ticks, "pgm"): _pnm_bytes("P5", 65535, depth.astype("<u2")),
            _name("r", color_s, start_ticks, "ppm"): _pnm_bytes("P6", 255, bgr[:, :, ::-1]),
        }
        for name, data in files.items():
            (folder / name).write_bytes(data)
        names += files
    (folder / INDEX).write_text("".join(f"{name}\n" for name in sorted(names, key=_host_time)))


def _name(kind: str, time_s: float, start_ticks: int, suffix: str) -> str:
    ticks = (start_ticks + round(time_s * TICKS_PER_S)) % 2**32
    return f"{kind}-{1000.0 + time_s:f}-{ticks}.{suffix}"


def _host_time(name: str) -> float:
    return float(name.split("-")[1])


def _pnm_bytes(magic: str, max_value: int, image: ColorBgr | DepthMm) -> bytes:
    """A header of one line, which fakenect needs, and the pixels; depth not in PGM's byte order."""
    return f"{magic} {COLUMNS} {ROWS} {max_value}\n".encode() + image.tobytes()
