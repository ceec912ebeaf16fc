"""Our TSDF fusion compared with OpenCV's volumes, on the virtual room with true poses.

    python -m benchmarks fusion [--seconds 10] [--seed 1] [--scale 1.0] [--json]

Each method runs in a separate process on one thread. Times are CPU times, the median over the
frames. Memory is the growth of the process with map and surface, without images. Distances are from
every point of the surface to the nearest true one. OpenCV's dense volumes allocate their memory at
the start and are limited to a box, here around the room; at 10 mm they would take 8 times the
memory of 20 mm.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import add_json_option, make_printer, print_json
from benchmarks.map_error import distances_m, make_solids, render_with_truth, scaled_camera
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform, transform_points
from drivers.synthetic import SyntheticConfig
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig

MAX_DEPTH_M = TsdfConfig().max_depth_m
TRUNCATION_VOXELS = 4.0
RAYCAST_EVERY = 60
# The box of a dense volume: the room and its walls.
BOX_M = (7.04, 6.40, 3.20)
MAX_POINTS = 200_000


class FusionVolume(Protocol):
    """A volume that fuses frames into a surface."""

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """Fuse one frame."""
        ...

    def points_m(self) -> Array:
        """Points (N, 3) of the surface, in the world."""
        ...


class ServiceVolume:
    """The volume of `kinect-vo reconstruct`."""

    def __init__(self, voxel_m: float) -> None:
        self._fusion = TsdfVolume(TsdfConfig(voxel_m=voxel_m, memory_mb=2000))

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        self._fusion.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)

    def points_m(self) -> Array:
        """See `FusionVolume`; the points are those of the mesh."""
        return self._fusion.extract_mesh().vertices_m.astype(np.float64)


class OpenCvVolume:
    """Base of OpenCV's volumes."""

    def __init__(self, kind: int, voxel_m: float) -> None:
        self._settings = cv2.VolumeSettings(kind)
        self._settings.setVoxelSize(voxel_m)
        self._settings.setTsdfTruncateDistance(TRUNCATION_VOXELS * voxel_m)
        self._settings.setMaxDepth(MAX_DEPTH_M)
        self._kind = kind
        self._volume: cv2.Volume | None = None

    def get_volume(self, frame: RgbdFrame) -> cv2.Volume:
        """Return the volume; create it for the first frame's camera and depth format."""
        if self._volume is None:
            self._settings.setDepthFactor(frame.depth_factor)
            self._settings.setIntegrateWidth(frame.camera.width)
            self._settings.setIntegrateHeight(frame.camera.height)
            self._settings.setCameraIntegrateIntrinsics(frame.camera.K.astype(np.float32))
            self._settings.setRaycastWidth(frame.camera.width)
            self._settings.setRaycastHeight(frame.camera.height)
            self._settings.setCameraRaycastIntrinsics(frame.camera.K.astype(np.float32))
            self._volume = cv2.Volume(self._kind, self._settings)
        return self._volume


class OpenCvHashVolume(OpenCvVolume):
    """OpenCV's sparse volume: points without colors, no triangles.

    `fetchPointsNormals` returns every voxel near the surface (opencv/opencv issue 22896), so the
    surface is ray-cast from some of the poses.
    """

    def __init__(self, voxel_m: float) -> None:
        super().__init__(cv2.VolumeType_HashTSDF, voxel_m)
        self._poses: list[Array] = []

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        depth = frame.depth_raw.astype(np.float32)
        self.get_volume(frame).integrate(depth, T_world_camera.astype(np.float32))
        self._poses.append(T_world_camera)

    def points_m(self) -> Array:
        """See `FusionVolume`."""
        return np.vstack([self._raycast_points_m(T) for T in self._poses[::RAYCAST_EVERY]])

    def _raycast_points_m(self, T_world_camera: Array) -> Array:
        assert self._volume is not None, "call add first"
        points_m = _to_points_m(
            np.asarray(self._volume.raycast(T_world_camera.astype(np.float32))[0])
        )
        met = np.all(np.isfinite(points_m), axis=1)
        return transform_points(T_world_camera, points_m[met])


class OpenCvDenseVolume(OpenCvVolume):
    """OpenCV's dense volume: a fixed box; points with colors, no triangles."""

    def __init__(self, voxel_m: float) -> None:
        super().__init__(cv2.VolumeType_ColorTSDF, voxel_m)
        resolution = np.array([round(side / voxel_m) for side in BOX_M], np.int32)
        self._settings.setVolumeResolution(resolution)
        corner_m = [-BOX_M[0] / 2, -BOX_M[1] / 2, -0.2]
        self._settings.setVolumePose(rigid_transform(np.eye(3), corner_m).astype(np.float32))

    def add(self, frame: RgbdFrame, T_world_camera: Array) -> None:
        """See `FusionVolume`."""
        depth = frame.depth_raw.astype(np.float32)
        # The binding only accepts four float channels.
        color = cv2.cvtColor(frame.color_bgr, cv2.COLOR_BGR2BGRA).astype(np.float32)
        pose = T_world_camera.astype(np.float32)
        self.get_volume(frame).integrateColor(depth, color, pose)

    def points_m(self) -> Array:
        """See `FusionVolume`."""
        assert self._volume is not None, "call add first"
        return _to_points_m(self._volume.fetchPointsNormalsColors()[0])


def _to_points_m(points: NDArray[Any]) -> Array:
    xyz: Array = points.reshape(-1, points.shape[-1])[:, :3].astype(np.float64)
    return xyz


# For each: whether the surface has colors and triangles, and what limits its memory.
CANDIDATES: Mapping[str, tuple[Callable[[], FusionVolume], str]] = {
    "ours, 10 mm": (partial(ServiceVolume, 0.01), "colors, triangles, bounded"),
    "cv2 HashTSDF, 10 mm": (partial(OpenCvHashVolume, 0.01), "points, no colors, grows"),
    "ours, 20 mm": (partial(ServiceVolume, 0.02), "colors, triangles, bounded"),
    "cv2 HashTSDF, 20 mm": (partial(OpenCvHashVolume, 0.02), "points, no colors, grows"),
    "cv2 ColorTSDF, 20 mm": (partial(OpenCvDenseVolume, 0.02), "colors, points, a fixed box"),
}


@dataclass(frozen=True)
class FusionResult:
    """Result of one fusion method; lengths in millimeters."""

    add_ms: float
    slowest_ms: float
    fetch_s: float
    memory_mb: float
    points: int
    median_mm: float
    p90_mm: float
    p99_mm: float
    has: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0, help="image size: 0.5 = 320 x 240")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    config = SyntheticConfig(
        seed=args.seed, duration_s=args.seconds, camera=scaled_camera(args.scale)
    )
    for _ in render_with_truth(config):  # rendered once, before anything is measured
        break
    print_line = make_printer(args)
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as processes:
        for name in CANDIDATES:
            result = processes.apply(measure, (name, config))
            print_line(format_row(name, result))
            print_json(args, {"name": name} | asdict(result))


def measure(name: str, config: SyntheticConfig) -> FusionResult:
    """Fuse the whole sequence and extract the surface."""
    cv2.setNumThreads(1)
    make, has = CANDIDATES[name]
    _fuse(make(), islice(render_with_truth(config), 1))  # compiles the kernels
    before_mb = _private_memory_mb()
    volume = make()
    add_ms, fetch_s, points_m = _fuse(volume, render_with_truth(config))
    memory_mb = _private_memory_mb() - before_mb
    del volume
    off_mm = 1e3 * distances_m(points_m[:: 1 + len(points_m) // MAX_POINTS], make_solids(config))
    return FusionResult(
        add_ms=float(np.median(add_ms)),
        slowest_ms=max(add_ms),
        fetch_s=fetch_s,
        memory_mb=memory_mb,
        points=len(points_m),
        median_mm=float(np.median(off_mm)),
        p90_mm=float(np.percentile(off_mm, 90)),
        p99_mm=float(np.percentile(off_mm, 99)),
        has=has,
    )


def format_row(name: str, result: FusionResult) -> str:
    """Format a line of text."""
    return (
        f"{name:20}  {result.add_ms:6.1f} ms a frame, {result.slowest_ms:6.1f} the slowest, fetch "
        f"{result.fetch_s:5.2f} s  {result.memory_mb:6.0f} MB  {result.points:8d} points, off by "
        f"{result.median_mm:5.1f} (median) {result.p90_mm:5.1f} (90 %) {result.p99_mm:6.1f} mm "
        f"(99 %)  {result.has}"
    )


def _fuse(
    volume: FusionVolume, frames: Iterable[tuple[RgbdFrame, Array]]
) -> tuple[list[float], float, Array]:
    """Return milliseconds of each frame, seconds for the surface, and its points (N, 3)."""
    add_ms = []
    for frame, T_world_camera in frames:
        frame.depth_m  # noqa: B018 (derived before the clock starts)
        begin_s = time.thread_time()
        volume.add(frame, T_world_camera)
        add_ms.append(1e3 * (time.thread_time() - begin_s))
    begin_s = time.thread_time()
    points_m = volume.points_m()
    return add_ms, time.thread_time() - begin_s, points_m


def _private_memory_mb() -> float:
    """Memory of this process that is not shared with files."""
    status = Path("/proc/self/status").read_text()
    kilobytes = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    return float(kilobytes.split()[1]) / 1e3
