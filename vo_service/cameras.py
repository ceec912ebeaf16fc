"""The cameras by name: the one place where a new backend is listed."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.camera import Clock, Pace, RgbdCamera
from drivers.errors import InputError
from drivers.isolation.messages import Recipe
from drivers.sensor_settings import SensorSettings
from drivers.synthetic.config import SyntheticConfig
from vo_service.folders import cache_folder

ONI_SUFFIX = ".oni"


@dataclass(frozen=True)
class CameraRequest:
    """What a camera is made from.

    source     as `USAGES` says
    file       camera file, for a sensor or for a recording without one of its own
    pace       for sources that have a choice
    sensor     a real sensor's settings
    synthetic  the virtual Kinect's settings
    """

    source: str
    file: Path | None
    pace: Pace
    sensor: SensorSettings
    synthetic: SyntheticConfig


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
    preparation = Preparation(cache_folder() / "films")
    return SyntheticCamera(request.synthetic, request.pace, preparation)


def _freenect(argument: str, request: CameraRequest) -> RgbdCamera:
    from drivers.freenect.recipes import kinect_camera

    recipe = partial(kinect_camera, argument, request.sensor, request.file)
    return _isolated(request, Clock.MONOTONIC, recipe)


def _fakenect(argument: str, request: CameraRequest) -> RgbdCamera:
    from drivers.freenect.recipes import fakenect_camera

    if not argument:
        raise InputError("camera 'fakenect' needs a dump's folder: fakenect:FOLDER")
    recipe = partial(fakenect_camera, Path(argument), request.file, request.pace)
    return _isolated(request, Clock.RECORDED, recipe)


def _openni2(argument: str, request: CameraRequest) -> RgbdCamera:
    if not argument.lower().endswith(ONI_SUFFIX):
        from drivers.openni2.camera import OpenNI2Camera

        device = partial(OpenNI2Camera, argument, request.file, request.sensor)
        return _isolated(request, Clock.MONOTONIC, device)

    from drivers.openni2.oni_camera import OniCamera

    recording = partial(OniCamera, Path(argument), request.file, request.pace, request.sensor)
    return _isolated(request, Clock.RECORDED, recording)


def _isolated(request: CameraRequest, clock: Clock, recipe: Recipe) -> RgbdCamera:
    """A camera on a native library, which may hang or crash: in a process of its own."""
    from drivers.isolation.camera import IsolatedCamera

    return IsolatedCamera(request.source, clock, recipe, request.pace)


BACKENDS: dict[str, Callable[[str, CameraRequest], RgbdCamera]] = {
    "freenect": _freenect,
    "openni2": _openni2,
    "fakenect": _fakenect,
    "tum": _tum,
    "synthetic": _synthetic,
}
USAGES = {
    "freenect": "freenect[:SERIAL]",
    "openni2": "openni2[:SERIAL] or openni2:FILE.oni",
    "fakenect": "fakenect:FOLDER",
    "tum": "tum:FOLDER",
    "synthetic": "synthetic",
}
