"""The cameras by name: the one place where a new backend is listed."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import Pace, RgbdCamera
from drivers.errors import InputError
from drivers.sensor_settings import SensorSettings
from drivers.synthetic.config import SyntheticConfig
from vo_service.folders import cache_folder

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class CameraRequest:
    """What a camera is made from.

    source     "synthetic", or "tum:FOLDER"
    file       camera file, for a recording without one of its own
    pace       for sources that have a choice
    sensor     a real sensor's settings
    synthetic  the virtual Kinect's settings
    progress   gets (done, total) while a virtual camera renders
    """

    source: str
    file: Path | None
    pace: Pace
    sensor: SensorSettings
    synthetic: SyntheticConfig
    progress: Progress


def make_camera(request: CameraRequest) -> RgbdCamera:
    """The camera that was asked for, not opened yet. Raises InputError for an unknown one."""
    kind, _, argument = request.source.partition(":")
    if kind not in BACKENDS:
        raise InputError(
            f"camera {request.source!r} is unknown; use one of: {', '.join(USAGES.values())}"
        )
    return BACKENDS[kind](argument, request)


def _tum(argument: str, request: CameraRequest) -> RgbdCamera:
    from drivers.tum.camera import TumCamera

    if not argument:
        raise InputError("camera 'tum' needs a folder: tum:FOLDER")
    return TumCamera(Path(argument), request.file, request.pace)


def _synthetic(argument: str, request: CameraRequest) -> RgbdCamera:
    from drivers.synthetic.camera import Preparation, SyntheticCamera

    if argument:
        raise InputError(
            f"camera 'synthetic:{argument}': it takes nothing after its name; "
            "set it up in the [synthetic] table of a configuration file"
        )
    if request.file is not None:
        raise InputError(f"{request.file}: the virtual Kinect knows its own camera; leave it out")
    preparation = Preparation(cache_dir=cache_folder() / "films", progress=request.progress)
    return SyntheticCamera(request.synthetic, request.pace, preparation)


BACKENDS: dict[str, Callable[[str, CameraRequest], RgbdCamera]] = {
    "synthetic": _synthetic,
    "tum": _tum,
}
USAGES = {"synthetic": "synthetic", "tum": "tum:FOLDER"}
