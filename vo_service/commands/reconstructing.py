"""The work of ``kinect-vo reconstruct``."""

import argparse
import json
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.trajectory import WITHIN_S, StampedPoses, has_partner, pose_line, read_trajectory
from drivers.tum.camera import TumCamera
from drivers.tum.folder import open_folder, paired_frames
from drivers.tum.whole_files import write_whole
from vo_service.commands.kernels import prepared
from vo_service.commands.loops_option import prepared_loops
from vo_service.commands.options import config_of
from vo_service.commands.tracking import tracked
from vo_service.config import Config
from vo_service.folders import make_output_folder
from vo_service.interrupts import Stop, stop_on_signals
from vo_service.mapping.frame_poses import FramePoses
from vo_service.mapping.fusion import Fusion
from vo_service.mapping.fusion_settings import FusionSettings
from vo_service.mapping.reconstruction import Harvest, Reconstruction
from vo_service.mapping.results import Results, refusals
from vo_service.mapping.warm_up import warm_up_mapping
from vo_service.mapping.watching import Sight
from vo_service.terminal import Terminal
from vo_service.viewer.preview import PreviewScene, open_previews

TRAJECTORY = "trajectory.txt"
_log = logging.getLogger(__name__)


def reconstruct(args: argparse.Namespace) -> int:
    """Find the poses, fuse, and leave the results. Raises InputError or UserFacingError."""
    config = config_of(args)
    camera_file = args.camera or config.camera.file
    terminal = Terminal()
    # Whatever would only fail after the work.
    if args.loops and args.trajectory is not None:
        raise InputError(
            f"{args.trajectory}: --loops corrects the poses of the odometry alone; leave one out"
        )
    open_folder(args.folder, camera_file)
    poses = None if args.trajectory is None else _read(args.trajectory, args.folder)
    of_places: Mapping[str, int] = {}
    fusion = _fusion(args)
    make_output_folder(args.output)
    with (
        stop_on_signals() as stop,
        open_previews(config.rerun.targets, "kinect-vo-reconstruct", _scene, terminal.say) as views,
    ):
        prepared(warm_up_mapping, terminal, stop)
        if poses is None:
            recording = TumCamera(args.folder, camera_file)
            poses, of_places = _tracked(args, recording, config, terminal, stop)
        reconstruction = Reconstruction(fusion, FramePoses(poses), views)
        with TumCamera(args.folder, camera_file) as camera, terminal.busy("fusing") as busy:
            reconstruction.run(camera, stop.event, busy.counted("frame"))
        with terminal.busy("making the map") as busy:
            results = _results(args.folder, reconstruction, fusion, stop)
            results = replace(results, of_places=of_places)
            results.save(args.output, busy.detail)
    terminal.say(f"results: {args.output}" + (" (cut short)" if results.is_cut_short else ""))
    print(json.dumps(results.as_json()) if args.json else results.as_table())
    return stop.exit_code


def _scene() -> type[PreviewScene[Sight]]:
    from vo_service.mapping.rerun_map import MapScene  # imports rerun

    return MapScene


def _fusion(args: argparse.Namespace) -> Fusion:
    try:
        return Fusion(FusionSettings(args.voxel_m, args.memory_mb, args.max_depth_m))
    except MemoryError as error:
        raise InputError(
            f"--memory-mb {args.memory_mb}: this computer does not have it; give less"
        ) from error


def _read(trajectory: Path, folder: Path) -> StampedPoses:
    """Poses for a recording. Raises InputError if they are of another one."""
    poses = read_trajectory(trajectory)
    frames_s = np.array([pair.colour.stamp_s for pair in paired_frames(folder).pairs])
    if not has_partner(frames_s, poses.stamps_s).any():
        raise InputError(
            f"{trajectory}: has no pose within {1000 * WITHIN_S:.0f} ms of any frame of {folder} "
            f"(poses {poses.stamps_s[0]:.3f}..{poses.stamps_s[-1]:.3f} s, frames "
            f"{frames_s[0]:.3f}..{frames_s[-1]:.3f} s): give a trajectory of this recording"
        )
    return poses


def _tracked(
    args: argparse.Namespace, camera: TumCamera, config: Config, terminal: Terminal, stop: Stop
) -> tuple[StampedPoses, Mapping[str, int]]:
    """The odometry's poses, which are left among the results; with loops, how many there were."""
    loops = prepared_loops(config, terminal, stop) if args.loops else None
    poses = tracked(args.folder, camera, config, terminal, stop, loops)
    lines = map(pose_line, poses.stamps_s, poses.T_world_camera)
    with refusals(args.output / TRAJECTORY):
        write_whole(args.output / TRAJECTORY, "".join(lines).encode())
    if loops is None:
        return poses, {}
    return poses, {"places": len(loops.closer.places), "loops": loops.closer.loops}


def _results(folder: Path, reconstruction: Reconstruction, fusion: Fusion, stop: Stop) -> Results:
    """The map, with a warning where it is not all that was asked for.

    Raises InputError if there is no surface in it, KeyboardInterrupt if it was stopped before.
    """
    harvest, mesh = reconstruction.harvest, reconstruction.finish()
    if harvest.camera is None or not len(mesh.triangles):
        stop.check()
        raise InputError(f"{folder}: {_why_nothing(harvest, fusion.settings.max_depth_m)}")
    if harvest.full_at:
        _log.warning(
            "the map was full at frame %d of %d: what came into view later is left out; give more "
            "than --memory-mb %d, or larger voxels than --voxel-m %g",
            harvest.full_at, harvest.frames, fusion.settings.memory_mb, fusion.settings.voxel_m,
        )  # fmt: skip
    title = f"{folder.resolve().name}: {harvest.fused} of {harvest.frames} frames, from above"
    return Results(title, harvest.camera, mesh, harvest, fusion, stop.event.is_set())


def _why_nothing(harvest: Harvest, max_depth_m: float) -> str:
    if harvest.without_depth and not harvest.fused:
        return (
            f"no depth up to {max_depth_m:g} m in any of {harvest.without_depth} frames; give a "
            "recording with depth, the right depth_factor, or a greater --max-depth-m"
        )
    return (
        f"{harvest.fused} of {harvest.frames} frames could be used, and no surface is known well "
        "by them; give more frames, or larger voxels with --voxel-m"
    )
