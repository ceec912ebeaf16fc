"""Which of a sensor's video modes to use."""

from collections.abc import Sequence

from drivers.camera_file import CameraFile
from drivers.errors import InputError
from drivers.openni2.images import DEPTH_FACTORS, TO_BGR
from drivers.openni2.library import Format, Sensor, VideoMode
from drivers.openni2.optics import Size

USUAL_SIZE, USUAL_FPS = (640, 480), 30


def choose_mode(sensor: Sensor, modes: Sequence[VideoMode], file: CameraFile | None) -> VideoMode:
    """The mode of the camera file's size, else the usual one, at 30 images a second if it can be.

    Raises InputError if no mode will do.
    """
    known = list(TO_BGR) if sensor is Sensor.COLOUR else list(DEPTH_FACTORS)
    usable = [mode for mode in modes if mode.format in known]
    if not usable:
        raise InputError(
            f"the sensor's {sensor.name.lower()} has no format that is supported; use another one"
        )
    size = _wanted_size(sensor, file)
    fitting = [mode for mode in usable if (mode.width, mode.height) == size]
    if not fitting and file is not None:
        sizes = ", ".join(sorted({f"{mode.width}x{mode.height}" for mode in usable}))
        raise InputError(
            f"the sensor has no {sensor.name.lower()} of {size[0]}x{size[1]}, for which the camera "
            f"file is; it has {sizes}"
        )

    def preference(mode: VideoMode) -> tuple[int, int]:
        return abs(mode.fps - USUAL_FPS), _format_rank(mode, known, file)

    return min(fitting or usable, key=preference)


def _wanted_size(sensor: Sensor, file: CameraFile | None) -> Size:
    if file is None:
        return USUAL_SIZE
    if sensor is Sensor.DEPTH and file.depth is not None:
        return file.depth.width, file.depth.height
    return file.width, file.height


def _format_rank(mode: VideoMode, known: Sequence[int], file: CameraFile | None) -> int:
    """0 is best: the unit that the camera file is for, then the order in which they are known."""
    factor = DEPTH_FACTORS.get(Format(mode.format))
    if file is not None and factor == file.depth_factor:
        return 0
    return 1 + known.index(mode.format)
