"""Distance of reconstructed surfaces of a virtual room from the true ones.

Distances are from every vertex or point to the nearest true surface, in millimeters. Times are CPU
milliseconds of one thread, the median over the frames.
"""

import argparse
import multiprocessing
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from benchmarks.harness import Table, Variants, measure_cpu_ms, median, option
from benchmarks.processes import memory_mb
from benchmarks.tracking import render_with_truth, track
from drivers.camera import RgbdFrame
from drivers.core.geometry import (
    Array,
    Trajectory,
    inverse,
    read_trajectory,
    rigid_transform,
    transform_points,
)
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import CLEARANCE_CHECKS_PER_S
from drivers.synthetic.room import ROOM_HEIGHT_M, build_room
from drivers.synthetic.solids import Solid, SolidKind
from tests.vo_service.reconstruction.ply_reader import read_ply
from vo_service.config import read_config
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig
from vo_service.tools.evaluation.evaluation import evaluate
from vo_service.tools.evaluation.metrics import associate, first_pose_alignment

GOOD_DISTANCE_M = 0.015
SURFACE_COLUMNS = ("vertices:10d", "median:8.1mm", "90 %:7.1mm", "99 %:7.1mm", "in 15 mm:10.1%")
POSES_TABLE = Table(20, "ATE:7.1mm", *SURFACE_COLUMNS, "ms a frame:12.1f", "mesh s:8.2f")
MAPS_TABLE = Table(40, "ATE:7.1mm", *SURFACE_COLUMNS)
VOLUMES_TABLE = Table(
    22, "ms a frame:12.1f", "slowest:9.1f", "fetch s:9.2f", "MB:7.0f", *SURFACE_COLUMNS
)
MEMORY_MB = 2000
VOXELS_M = (0.01, 0.02)
MAX_DEPTH_M = TsdfConfig().max_depth_m
TRUNCATION_VOXELS = 4.0
RAYCAST_EVERY = 60
# The box of a dense volume: the room and its walls.
BOX_M = (7.04, 6.40, 3.20)
MAX_POINTS = 200_000


def surface_cells(vertices_m: Array, solids: Sequence[Solid]) -> tuple[float, ...]:
    """The cells of `SURFACE_COLUMNS`: distances of vertices (N, 3) from the true surface."""
    off_m = distances_m(vertices_m, solids)
    percentiles_m = np.percentile(off_m, (50, 90, 99))
    return (len(off_m), *percentiles_m, float(np.mean(off_m <= GOOD_DISTANCE_M)))


def make_solids(config: SyntheticConfig) -> Sequence[Solid]:
    """Make the solids of the room of a configuration."""
    path = make_motion(config, ROOM_HEIGHT_M)
    checks = max(2, int(config.duration_s * CLEARANCE_CHECKS_PER_S))
    free_m = path.clearance_points_m(np.linspace(0.0, config.duration_s, checks))
    return build_room(config.seed, free_m, config.bare_wall, config.twin_corners)


def distances_m(points_m: Array, solids: Sequence[Solid]) -> Array:
    """Distances (N,) from points (N, 3) in the room to the nearest surface of any solid."""
    nearest_m = np.full(len(points_m), np.inf)
    for solid in solids:
        local_m = transform_points(inverse(solid.T_world_solid), points_m)
        # Only points that may be nearer than the best distance so far are computed.
        outside_m = np.linalg.norm(np.maximum(np.abs(local_m) - solid.half_m, 0.0), axis=1)
        near = np.flatnonzero(outside_m < nearest_m)
        nearest_m[near] = np.minimum(nearest_m[near], _distance_m(local_m[near], solid))
    return nearest_m


def _distance_m(local_m: Array, solid: Solid) -> Array:
    """Distances (N,) of points in the solid's frame to its surface; to first order for a sphere."""
    half_m = solid.half_m
    distance_m: Array
    if solid.kind is SolidKind.CYLINDER:  # width equals depth, and the ends are open
        across_m = np.hypot(local_m[:, 0], local_m[:, 1]) - half_m[0]
        distance_m = np.hypot(across_m, np.maximum(np.abs(local_m[:, 2]) - half_m[2], 0.0))
    elif solid.kind is SolidKind.SPHERE:
        unit = np.linalg.norm(local_m / half_m, axis=1)
        slope = np.linalg.norm(local_m / half_m**2, axis=1)
        distance_m = np.abs(unit * (unit - 1.0) / np.maximum(slope, 1e-9))
    else:
        beyond_m = np.abs(local_m) - half_m
        outside_m = np.linalg.norm(np.maximum(beyond_m, 0.0), axis=1)
        distance_m = np.abs(outside_m + np.minimum(beyond_m.max(axis=1), 0.0))
    return distance_m


@option("--seconds", type=float, default=20.0)
def measure_poses(args: argparse.Namespace) -> None:
    """Maps of a virtual room with true poses, and with those of the odometry.

    The virtual Kinect has all sensor faults: depth noise and quantization, shadows, ragged edges, a
    rolling shutter, depth 10 ms after color. The first pose of the odometry (`surf`) is aligned
    with the true one.
    """
    config = SyntheticConfig(duration_s=args.seconds)
    frames, poses = zip(*render_with_truth(config), strict=True)
    truth = Trajectory(np.array([frame.stamp_s for frame in frames]), np.array(poses))
    tracked = track("surf", frames).trajectory
    in_room = Trajectory(tracked.stamps_s, poses[0] @ tracked.T_world_camera)
    solids = make_solids(config)
    print(POSES_TABLE.head)
    for voxel_m in VOXELS_M:
        for name, known in (("truth", truth), ("surf", in_room)):
            posed = ((frame, known.pose_near(frame.stamp_s)) for frame in frames)
            fused = [(frame, T) for frame, T in posed if T is not None]
            add_ms, mesh_s, points_m = _fuse(ServiceVolume(voxel_m), fused)
            cells = (evaluate(known, truth).ate_rmse_m, *surface_cells(points_m, solids))
            row = f"{1e3 * voxel_m:g} mm, {name}"
            print(POSES_TABLE.row(row, *cells, median(add_ms), mesh_s), flush=True)


@option("config", metavar="CONFIG", type=Path)
@option("recording", metavar="RECORDING", type=Path)
@option("maps", metavar="MAP", type=Path, nargs="+")
def measure_maps(args: argparse.Namespace) -> None:
    """Distance of maps of a virtual room from its true surfaces.

    RECORDING was made by `kinect-vo record --config CONFIG`. Each MAP is the output folder of
    `kinect-vo reconstruct RECORDING --output MAP`, without a TRAJECTORY. The first pose of a map is
    aligned with the true one.
    """
    solids = make_solids(read_config(args.config).synthetic)
    truth = read_trajectory(args.recording / "groundtruth.txt")
    print(MAPS_TABLE.head)
    for folder in args.maps:
        print(MAPS_TABLE.row(str(folder), *measure_map(folder, truth, solids)), flush=True)


def measure_map(folder: Path, truth: Trajectory, solids: Sequence[Solid]) -> tuple[float, ...]:
    """Measure the ATE RMSE of a map's poses, and its surface; return the cells of its row."""
    poses = read_trajectory(folder / "trajectory.txt")
    T_room_map = first_pose_alignment(associate(poses, truth))
    vertices_m = read_ply(folder / "map.ply").vertices_m.astype(np.float64)
    in_room_m = transform_points(T_room_map, vertices_m)
    return (evaluate(poses, truth).ate_rmse_m, *surface_cells(in_room_m, solids))


class FusionVolume(Protocol):
    """A volume that fuses frames into a surface."""

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """Fuse one frame."""
        ...

    def points_m(self) -> Array:
        """Points (N, 3) of the surface, in the world."""
        ...


class ServiceVolume(TsdfVolume):
    """The volume of `kinect-vo reconstruct`; its points are the vertices of the mesh."""

    def __init__(self, voxel_m: float) -> None:
        super().__init__(TsdfConfig(voxel_m=voxel_m, memory_mb=MEMORY_MB))

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        self.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)

    def points_m(self) -> Array:
        return self.extract_mesh().vertices_m.astype(np.float64)


def make_settings(kind: int, voxel_m: float) -> cv2.VolumeSettings:
    """Make the settings of an OpenCV volume for frames of the virtual Kinect."""
    settings, config = cv2.VolumeSettings(kind), SyntheticConfig()
    settings.setVoxelSize(voxel_m)
    settings.setTsdfTruncateDistance(TRUNCATION_VOXELS * voxel_m)
    settings.setMaxDepth(MAX_DEPTH_M)
    settings.setDepthFactor(config.depth_factor)
    settings.setIntegrateWidth(config.camera.width)
    settings.setIntegrateHeight(config.camera.height)
    settings.setCameraIntegrateIntrinsics(config.camera.K.astype(np.float32))
    settings.setRaycastWidth(config.camera.width)
    settings.setRaycastHeight(config.camera.height)
    settings.setCameraRaycastIntrinsics(config.camera.K.astype(np.float32))
    return settings


class OpenCvHashVolume:
    """OpenCV's sparse volume: points without colors, no triangles.

    `fetchPointsNormals` returns every voxel near the surface (opencv/opencv issue 22896), so the
    surface is ray-cast from some of the poses.
    """

    def __init__(self, voxel_m: float) -> None:
        kind = cv2.VolumeType_HashTSDF
        self._volume = cv2.Volume(kind, make_settings(kind, voxel_m))
        self._poses: list[Array] = []

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        depth = frame.depth_raw.astype(np.float32)
        self._volume.integrate(depth, T_world_camera.astype(np.float32))
        self._poses.append(T_world_camera)

    def points_m(self) -> Array:
        return np.vstack([self._raycast_points_m(T) for T in self._poses[::RAYCAST_EVERY]])

    def _raycast_points_m(self, T_world_camera: Array) -> Array:
        points, *_ = self._volume.raycast(T_world_camera.astype(np.float32))
        points_m = np.asarray(points.reshape(-1, points.shape[-1])[:, :3], np.float64)
        met = np.all(np.isfinite(points_m), axis=1)
        return transform_points(T_world_camera, points_m[met])


class OpenCvDenseVolume:
    """OpenCV's dense volume: a fixed box; points with colors, no triangles."""

    def __init__(self, voxel_m: float) -> None:
        kind = cv2.VolumeType_ColorTSDF
        settings = make_settings(kind, voxel_m)
        resolution = np.array([round(side / voxel_m) for side in BOX_M], np.int32)
        settings.setVolumeResolution(resolution)
        corner_m = [-BOX_M[0] / 2, -BOX_M[1] / 2, -0.2]
        settings.setVolumePose(rigid_transform(np.eye(3), corner_m).astype(np.float32))
        self._volume = cv2.Volume(kind, settings)

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        depth = frame.depth_raw.astype(np.float32)
        # The binding only accepts four float channels.
        color = cv2.cvtColor(frame.color_bgr, cv2.COLOR_BGR2BGRA).astype(np.float32)
        self._volume.integrateColor(depth, color, T_world_camera.astype(np.float32))

    def points_m(self) -> Array:
        points = self._volume.fetchPointsNormalsColors()[0]
        return np.asarray(points.reshape(-1, points.shape[-1])[:, :3], np.float64)


CANDIDATES: Mapping[str, Callable[[], FusionVolume]] = {
    "ours, 10 mm": partial(ServiceVolume, 0.01),
    "cv2 HashTSDF, 10 mm": partial(OpenCvHashVolume, 0.01),
    "ours, 20 mm": partial(ServiceVolume, 0.02),
    "cv2 HashTSDF, 20 mm": partial(OpenCvHashVolume, 0.02),
    "cv2 ColorTSDF, 20 mm": partial(OpenCvDenseVolume, 0.02),
}


@option("--seconds", type=float, default=10.0)
def measure_volumes(args: argparse.Namespace) -> None:
    """Our TSDF fusion compared with OpenCV's volumes, on the virtual room with true poses.

    Each method runs in a separate process. Memory is the growth of the process with map and
    surface, without images. OpenCV's dense volumes allocate their memory at the start and are
    limited to a box, here around the room; at 10 mm they would take 8 times the memory of 20 mm.
    Its surfaces are points; ours is a mesh with colors.
    """
    config = SyntheticConfig(duration_s=args.seconds)
    for _ in render_with_truth(config):  # rendered once, before anything is measured
        break
    print(VOLUMES_TABLE.head)
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as processes:
        for name in CANDIDATES:
            cells = processes.apply(measure_volume, (name, config))
            print(VOLUMES_TABLE.row(name, *cells), flush=True)


def measure_volume(name: str, config: SyntheticConfig) -> tuple[float, ...]:
    """Fuse the whole sequence and extract the surface; return the cells of its row."""
    cv2.setNumThreads(1)
    make = CANDIDATES[name]
    _fuse(make(), islice(render_with_truth(config), 1))  # compiles the kernels
    before_mb = memory_mb(os.getpid(), "RssAnon")
    volume = make()
    add_ms, fetch_s, points_m = _fuse(volume, render_with_truth(config))
    used_mb = memory_mb(os.getpid(), "RssAnon") - before_mb
    del volume
    some_m = points_m[:: 1 + len(points_m) // MAX_POINTS]
    costs = (median(add_ms), max(add_ms), fetch_s, used_mb)
    return (*costs, *surface_cells(some_m, make_solids(config)))


def _fuse(
    volume: FusionVolume, frames: Iterable[tuple[RgbdFrame, Array]]
) -> tuple[list[float], float, Array]:
    """Return milliseconds of each frame, seconds for the surface, and its points (N, 3)."""
    add_ms = []
    for frame, T_world_camera in frames:
        frame.depth_m  # noqa: B018 (derived before the clock starts)
        add_ms.append(measure_cpu_ms(partial(volume.add, frame, T_world_camera))[1])
    points_m, fetch_ms = measure_cpu_ms(volume.points_m)
    return add_ms, fetch_ms / 1e3, points_m


VARIANTS: Variants = {
    "poses": measure_poses,
    "maps": measure_maps,
    "volumes": measure_volumes,
}
