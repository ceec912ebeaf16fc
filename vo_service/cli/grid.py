"""``kinect-vo grid``: make the occupancy grid of a recording."""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.files import atomic_write
from drivers.core.geometry import quaternion_from_rotation, so3_exp
from drivers.core.write_errors import create_output_folder
from drivers.playback.camera import RecordingCamera
from vo_service.app import run_replay
from vo_service.cli.kernels import prepare_kernels
from vo_service.cli.options import (
    CameraFile,
    ConfigFile,
    Method,
    Recording,
    Timing,
    Topics,
    load_config,
    parse_height_m,
    parse_tilt_deg,
)
from vo_service.cli.recordings import open_requested
from vo_service.cli.request import CommandRequest, argument, option
from vo_service.config import Config, MountingConfig
from vo_service.frame_source import FrameSource
from vo_service.navigation.grid_files import (
    encode_grid_image,
    encode_grid_picture,
    encode_grid_settings,
)
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.navigation.grid_recorder import GridRecorder
from vo_service.navigation.height_limits import mounting_problem
from vo_service.outputs.progress import ProgressOutput
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal, announce
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED

EPILOG = """\
examples:
  kinect-vo grid recordings/drive maps/drive --config robot.toml
  kinect-vo grid recordings/kitchen maps/kitchen --camera-height 1.37 --camera-tilt 25

OUTPUT receives map.pgm and map.yaml, which map_server of Nav2 loads, and map.png to look at. Black
is occupied, white free, gray unknown. Heights and cells are those of the tables [scan] and [map];
the camera's place is that of [T_base_camera], or of the two options for a camera in a hand. A map
that is there already is never replaced. Ctrl-C ends with the map of the frames so far.
"""
FILES = ("map.pgm", "map.yaml", "map.png")


@dataclass(frozen=True, kw_only=True)
class GridRequest(CommandRequest):
    """The recording, and where the camera was."""

    folder: Recording
    output: Path = argument("folder for the results", "OUTPUT")
    topics: Topics = None
    config: ConfigFile = None
    method: Method = None
    timing: Timing = None
    camera_file: CameraFile = None
    camera_height: float | None = option(
        "height of the camera above the floor at the first frame, m", None, "M", parse_height_m
    )
    camera_tilt: float | None = option(
        "how far it looks down at the first frame, degrees", None, "DEG", parse_tilt_deg
    )


def run(request: GridRequest) -> int:
    """Run the odometry over the recording, and write the grid."""
    config = _with_mounting(load_config(request.config, request), request)
    T_base_camera = config.T_base_camera.T_base_camera
    if problem := mounting_problem(config.scan, T_base_camera):
        raise InputError(f"{problem}; or give --camera-height and --camera-tilt")
    open_requested(request.folder, config.camera.file, request.topics)
    is_new = not request.output.is_dir()
    _create_output(request.output)
    terminal = Terminal()
    mapper = GridMapper(config.scan, T_base_camera, config.map.resolution_m, config.map.range_max_m)
    recorder = GridRecorder(mapper)
    with stop_on_signals() as stop:
        prepare_kernels(config, terminal, stop)
        camera = RecordingCamera(request.folder, config.camera.file, topics=request.topics)
        with camera:
            progress = ProgressOutput(terminal, "mapping", camera.frame_count)
            result = run_replay(config, camera, FrameSource(camera), [recorder, progress], stop)
        progress.close()
    grid = recorder.render()
    if grid is NO_GRID:
        if is_new:
            with suppress(OSError):
                request.output.rmdir()
        if result.exit_code:
            announce(f"{request.folder}: cut short before a floor or an obstacle was seen")
            return result.exit_code
        raise InputError(f"{request.folder}: no floor and no obstacle was seen")
    image, settings, picture = FILES
    atomic_write(request.output / image, encode_grid_image(grid))
    atomic_write(request.output / settings, encode_grid_settings(grid, image))
    atomic_write(request.output / picture, encode_grid_picture(grid))
    height, width = np.array(grid.cells.shape) * grid.resolution_m
    areas_m2 = [np.count_nonzero(grid.cells == v) * grid.resolution_m**2 for v in (FREE, OCCUPIED)]
    print(
        f"{request.output}: {width:g} x {height:g} m of {recorder.frame_count} frames, "
        f"{areas_m2[0]:.1f} m2 free, {areas_m2[1]:.1f} m2 occupied"
        f"{' (cut short)' if result.exit_code else ''}"
    )
    return result.exit_code


def _create_output(folder: Path) -> None:
    """Create the folder before the work. Raises UserFacingError if it cannot take a new map."""
    create_output_folder(folder)
    for name in FILES:
        if (folder / name).exists():
            raise InputError(f"{folder / name}: exists already; name a new folder")


def _with_mounting(config: Config, request: GridRequest) -> Config:
    """Return the configuration with the camera's place of the options."""
    if request.camera_height is None and request.camera_tilt is None:
        return config
    mounting = config.T_base_camera
    x, y, z = mounting.translation_m
    if request.camera_height is not None:
        z = request.camera_height
    if request.camera_tilt is not None:
        tilt = so3_exp([0.0, np.radians(request.camera_tilt), 0.0])
        R = tilt @ MountingConfig().T_base_camera[:3, :3]
        a, b, c, d = map(float, quaternion_from_rotation(R))
        mounting = replace(mounting, quaternion_xyzw=(a, b, c, d))
    return replace(config, T_base_camera=replace(mounting, translation_m=(x, y, z)))
