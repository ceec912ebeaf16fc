"""Which of a sensor's video modes to use."""

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
    """The mode of the camera file's size, else the usual one, at 30 images a second if it can be.

    Raises InputError if no mode will do.
    """
    known = list(TO_BGR) if sensor is SensorType.COLOR else list(DEPTH_FACTORS)
    usable = [mode for mode in modes if mode.format in known]
    if not usable:
        raise InputError(
            f"the sensor's {sensor.name.lower()} has no format that is supported; use another one"
        )
    size = _wanted_size(sensor, calibration)
    fitting = [mode for mode in usable if (mode.width, mode.height) == size]
    if not fitting and calibration is not None:
        sizes = ", ".join(sorted({f"{mode.width}x{mode.height}" for mode in usable}))
        raise InputError(
            f"the sensor has no {sensor.name.lower()} of {size[0]}x{size[1]}, for which the camera "
            f"file is; it has {sizes}"
        )

    def preference(mode: VideoMode) -> tuple[int, int]:
        return abs(mode.fps - PREFERRED_FPS), _format_rank(mode, known, calibration)

    return min(fitting or usable, key=preference)


def _wanted_size(sensor: SensorType, calibration: CameraCalibration | None) -> Size:
    if calibration is None:
        return PREFERRED_SIZE
    if sensor is SensorType.DEPTH and calibration.depth is not None:
        return calibration.depth.width, calibration.depth.height
    return calibration.width, calibration.height


def _format_rank(
    mode: VideoMode, known: Sequence[int], calibration: CameraCalibration | None
) -> int:
    """0 is best: the unit that the camera file is for, then the order in which they are known."""
    factor = DEPTH_FACTORS.get(PixelFormat(mode.format))
    if calibration is not None and factor == calibration.depth_factor:
        return 0
    return 1 + known.index(mode.format)
