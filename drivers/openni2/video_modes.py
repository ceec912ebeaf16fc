"""Choice of a sensor's video mode."""

from collections.abc import Sequence

from drivers.calibration import CameraCalibration
from drivers.core.errors import InputError
from drivers.openni2.decode import DEPTH_FACTORS, TO_BGR
from drivers.openni2.library import PixelFormat, SensorType, VideoMode
from drivers.openni2.rectify import Size

PREFERRED_SIZE, PREFERRED_FPS = (640, 480), 30


def choose_video_mode(
    sensor: SensorType, modes: Sequence[VideoMode], calibration: CameraCalibration | None
) -> VideoMode:
    """Choose the mode with the camera file's size, else 640x480, and nearest to 30 images/s.

    Raises:
        InputError: No mode is usable.
    """
    formats = list(TO_BGR) if sensor is SensorType.COLOR else list(DEPTH_FACTORS)
    usable = [mode for mode in modes if mode.format in formats]
    if not usable:
        raise InputError(
            f"the sensor's {sensor.name.lower()} has no supported format; use another sensor"
        )
    size = _wanted_size(sensor, calibration)
    fitting = [mode for mode in usable if (mode.width, mode.height) == size]
    if not fitting and calibration is not None:
        sizes = ", ".join(sorted({f"{mode.width}x{mode.height}" for mode in usable}))
        raise InputError(
            f"the sensor has no {sensor.name.lower()} of {size[0]}x{size[1]}, the size in the "
            f"camera file; it has {sizes}"
        )

    def preference(mode: VideoMode) -> tuple[int, int]:
        return abs(mode.fps - PREFERRED_FPS), _format_rank(mode, formats, calibration)

    return min(fitting or usable, key=preference)


def _wanted_size(sensor: SensorType, calibration: CameraCalibration | None) -> Size:
    if calibration is None:
        return PREFERRED_SIZE
    if sensor is SensorType.DEPTH and calibration.depth is not None:
        return calibration.depth.width, calibration.depth.height
    return calibration.width, calibration.height


def _format_rank(
    mode: VideoMode, formats: Sequence[int], calibration: CameraCalibration | None
) -> int:
    """Rank a mode's format, 0 is best: the camera file's unit first, then in listed order."""
    factor = DEPTH_FACTORS.get(PixelFormat(mode.format))
    if calibration is not None and factor == calibration.depth_factor:
        return 0
    return 1 + formats.index(mode.format)
