"""The cameras by name. Knows nothing of odometry.

A camera is a function of `CameraRequest` in the entry-point group `kinect_vo.cameras`, and is
imported when it is opened.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core import InputError, PluginGroup

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.camera import CameraFactory, PlaybackMode, RgbdCamera, SensorConfig
    from drivers.synthetic.config import SyntheticConfig


ONI_SUFFIX = ".oni"
SENSORS = ("freenect", "openni2")
# How to write each built-in camera.
CAMERA_USAGES = {
    "freenect": "freenect[:SERIAL]",
    "openni2": "openni2[:SERIAL] or openni2:FILE.oni",
    "fakenect": "fakenect:FOLDER",
    "tum": "tum:FOLDER",
    "bag": "bag:FILE",
    "synthetic": "synthetic",
}


@dataclass(frozen=True)
class CameraRequest:
    """What a camera's factory gets; see `open_camera`.

    Attributes:
        source: The whole source, such as "tum:FOLDER".
        argument: What follows the name and the colon; "" for nothing.
        synthetic: None for a virtual Kinect that plays without end.
    """

    source: str
    argument: str
    camera_file: Path | None
    playback_mode: PlaybackMode
    sensor: SensorConfig
    synthetic: SyntheticConfig | None
    topics: tuple[str, str] | None


# The built-in cameras, and those of installed plug-ins.
CAMERAS: PluginGroup[Callable[[CameraRequest], RgbdCamera]] = PluginGroup(
    "kinect_vo.cameras", "camera", tuple(CAMERA_USAGES)
)


def describe_cameras() -> str:
    """Return how to write each camera, plug-ins too, for a message."""
    plugins = [f"{name}[:ARGUMENT]" for name in CAMERAS.plugins]
    return ", ".join([*CAMERA_USAGES.values(), *plugins])


def open_camera(
    source: str,
    *,
    camera_file: str | Path | None = None,
    playback_mode: PlaybackMode | None = None,
    sensor: SensorConfig | None = None,
    synthetic: SyntheticConfig | None = None,
    topics: tuple[str, str] | None = None,
) -> RgbdCamera:
    """Make the camera that a source names; the `with` statement opens and closes it.

        with open_camera("tum:recordings/desk") as camera:
            for frame in camera:
                print(frame.stamp_s, frame.depth_m.max())

    Args:
        source: As for `--camera` on the command line: "freenect", "freenect:SERIAL", "openni2",
            "openni2:SERIAL", "openni2:FILE.oni", "fakenect:FOLDER", "tum:FOLDER", "bag:FILE" (MCAP
            or a ROS bag), "synthetic", or NAME[:ARGUMENT] of a plug-in. The path of a recording
            alone is enough.
        camera_file: Camera file (TOML) with intrinsics, distortion and registration; None for that
            of the recording, or the usual values of the sensor.
        playback_mode: LOCKSTEP delivers every frame in order, as fast as they are read. REALTIME
            delivers them at their own rate, without those that were not read in time. None is
            REALTIME for a sensor or a plug-in, and LOCKSTEP for recordings and the virtual Kinect.
        sensor: Settings of a real sensor; None for the defaults.
        synthetic: Settings of the virtual Kinect; None for one that plays without end.
        topics: The topics of the color and the depth images in a bag; None to find them.

    Returns:
        The camera, not opened yet. Opening it raises the errors of `RgbdCamera.open`.

    Raises:
        InputError: The source is unknown, or its argument or camera file is wrong.
    """
    from drivers.camera import PlaybackMode, SensorConfig

    kind, _, argument = source.partition(":")
    if kind not in CAMERAS and source and Path(source).exists():
        from drivers.playback.recording_formats import recording_format

        kind, argument = recording_format(Path(source)), source
    if kind not in CAMERAS:
        raise InputError(f"camera {source!r} is unknown; use one of: {describe_cameras()}")
    if topics is not None and kind != "bag":
        raise InputError(f"camera {source!r} has no topics; leave out --topics")
    is_recording = _is_recording(kind, argument)
    default_mode = PlaybackMode.LOCKSTEP if is_recording else PlaybackMode.REALTIME
    request = CameraRequest(
        source=source,
        argument=argument,
        camera_file=None if camera_file is None else Path(camera_file),
        playback_mode=PlaybackMode(playback_mode or default_mode),
        sensor=sensor or SensorConfig(),
        synthetic=synthetic,
        topics=topics,
    )
    return CAMERAS[kind](request)


def make_reconnecting(camera: RgbdCamera) -> RgbdCamera:
    """Return a camera that is opened again whenever it is lost: itself, if it does so already."""
    if camera.reconnects:
        return camera
    from drivers.reconnect import ReconnectingCamera

    return ReconnectingCamera(camera)


def _is_recording(kind: str, argument: str) -> bool:
    """Whether a camera plays a recording; the virtual Kinect counts as one."""
    if kind == "openni2":
        return argument.lower().endswith(ONI_SUFFIX)
    return kind in CAMERA_USAGES and kind not in SENSORS


def make_recording(request: CameraRequest) -> RgbdCamera:
    from drivers.playback.camera import RecordingCamera

    if not request.argument:
        kind = request.source.partition(":")[0]
        what = "folder" if kind == "tum" else "file"
        raise InputError(f"camera {kind!r} needs a {what}: {CAMERA_USAGES[kind]}")
    return RecordingCamera(
        Path(request.argument), request.camera_file, request.playback_mode, topics=request.topics
    )


def make_synthetic(request: CameraRequest) -> RgbdCamera:
    from drivers.core.folders import cache_folder
    from drivers.synthetic.camera import make_synthetic_camera
    from drivers.synthetic.config import SyntheticConfig

    if request.argument:
        raise InputError(
            f"camera 'synthetic:{request.argument}': it takes no argument; "
            "set it up in the [synthetic] table of a configuration file"
        )
    if request.camera_file is not None:
        raise InputError(
            f"{request.camera_file}: the virtual Kinect takes no camera file; leave it out"
        )
    config = request.synthetic or SyntheticConfig.fast()
    return make_synthetic_camera(config, cache_folder() / "sequences", request.playback_mode)


def make_freenect(request: CameraRequest) -> RgbdCamera:
    from drivers.freenect.camera import make_kinect_camera

    factory = partial(make_kinect_camera, request.argument, request.sensor, request.camera_file)
    return _in_subprocess(request, factory)


def make_fakenect(request: CameraRequest) -> RgbdCamera:
    from drivers.freenect.camera import make_fakenect_camera

    if not request.argument:
        raise InputError("camera 'fakenect' needs the folder of a dump: fakenect:FOLDER")
    factory = partial(
        make_fakenect_camera, Path(request.argument), request.camera_file, request.playback_mode
    )
    return _in_subprocess(request, factory)


def make_openni2(request: CameraRequest) -> RgbdCamera:
    if not request.argument.lower().endswith(ONI_SUFFIX):
        from drivers.openni2.camera import OpenNI2Camera

        device = partial(OpenNI2Camera, request.argument, request.camera_file, request.sensor)
        return _in_subprocess(request, device)

    from drivers.openni2.oni_camera import OniCamera

    recording = partial(
        OniCamera,
        Path(request.argument),
        request.camera_file,
        request.playback_mode,
        request.sensor,
    )
    return _in_subprocess(request, recording)


def _in_subprocess(request: CameraRequest, factory: CameraFactory) -> RgbdCamera:
    """Run a camera in a process of its own, because its native library may hang or crash."""
    from drivers.camera import Clock
    from drivers.subprocess_camera.camera import SubprocessCamera

    kind = request.source.partition(":")[0]
    clock = Clock.RECORDED if _is_recording(kind, request.argument) else Clock.MONOTONIC
    return SubprocessCamera(request.source, clock, factory, request.playback_mode)
