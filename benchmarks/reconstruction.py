"""Distance of maps of a virtual room from its true surfaces, for true and estimated poses.

    python -m benchmarks reconstruction [--seconds 20] [--seed 1] [--voxels 0.01 0.02] [--json]

The virtual Kinect has all sensor faults: depth noise and quantization, shadows, ragged edges, a
rolling shutter, depth 10 ms after color. Each map is made with the true poses and with those of
the odometry, whose first pose is aligned with the true one. Distances are from every vertex of the
mesh to the nearest true surface.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.harness import add_json_option, make_printer, print_json
from benchmarks.map_error import SurfaceError, make_solids, render_with_truth, scaled_camera
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, Trajectory
from drivers.synthetic import SyntheticConfig
from vo_service.odometry import METHODS, CpuStageTimer, MethodConfig
from vo_service.reconstruction.reconstructor import FramePoses
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig
from vo_service.tools.evaluation import evaluate


@dataclass(frozen=True)
class ReconstructionBenchmarkResult:
    """Result of one map.

    `poses` is the source of the poses, and `ate_rmse_m` their ATE. `add_ms` is the median CPU time
    of a frame, and `mesh_s` that of the mesh.
    """

    voxel_m: float
    poses: str
    ate_rmse_m: float
    surface: SurfaceError
    add_ms: float
    mesh_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0, help="image size: 0.5 = 320 x 240")
    parser.add_argument("--voxels", type=float, nargs="+", default=[0.01, 0.02], metavar="M")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    config = SyntheticConfig(
        seed=args.seed, duration_s=args.seconds, camera=scaled_camera(args.scale)
    )
    print_line = make_printer(args)
    for result in measure(config, args.voxels):
        print_line(format_row(result))
        print_json(args, asdict(result))


def measure(
    config: SyntheticConfig, voxels_m: Sequence[float]
) -> Iterator[ReconstructionBenchmarkResult]:
    """Yield a result for each voxel size and each source of poses."""
    frames, poses = zip(*render_with_truth(config), strict=True)
    truth = Trajectory(np.array([frame.stamp_s for frame in frames]), np.array(poses))
    tracked = _track(frames, truth)
    for voxel_m in voxels_m:
        for name, known in (("truth", truth), ("surf", tracked)):
            yield _measure_map(config, frames, voxel_m, name, known, truth)


def format_row(result: ReconstructionBenchmarkResult) -> str:
    """Format a line of text."""
    surface = result.surface
    return (
        f"voxel {1000 * result.voxel_m:3.0f} mm  poses {result.poses:5}  "
        f"ATE {1000 * result.ate_rmse_m:6.1f} mm  vertices {surface.vertices:8d}  distance: median "
        f"{1000 * surface.median_m:5.1f} mm, 90 % {1000 * surface.p90_m:5.1f} mm, "
        f"99 % {1000 * surface.p99_m:6.1f} mm, {100 * surface.within_15mm:5.1f} % within 15 mm  "
        f"{result.add_ms:5.1f} ms a frame, mesh {result.mesh_s:.2f} s"
    )


def _measure_map(
    config: SyntheticConfig,
    frames: Sequence[RgbdFrame],
    voxel_m: float,
    name: str,
    poses: Trajectory,
    truth: Trajectory,
) -> ReconstructionBenchmarkResult:
    fusion = TsdfVolume(TsdfConfig(voxel_m=voxel_m, memory_mb=2000))
    poses_at = FramePoses(poses)
    add_ms = []
    for frame in frames:
        T = poses_at.find(frame.stamp_s)
        if T is not None:
            begin_s = time.thread_time()
            fusion.integrate(frame.depth_m, frame.color_bgr, frame.camera, T)
            add_ms.append(1e3 * (time.thread_time() - begin_s))
    begin_s = time.thread_time()
    mesh = fusion.extract_mesh()
    mesh_s = time.thread_time() - begin_s
    return ReconstructionBenchmarkResult(
        voxel_m=voxel_m,
        poses=name,
        ate_rmse_m=evaluate(poses, truth).ate_rmse_m,
        surface=SurfaceError.from_vertices(mesh.vertices_m.astype(np.float64), make_solids(config)),
        add_ms=float(np.median(add_ms)),
        mesh_s=mesh_s,
    )


def _track(frames: Sequence[RgbdFrame], truth: Trajectory) -> Trajectory:
    """Poses of the odometry in the room, of the frames that have one."""
    odometry = METHODS["surf"](MethodConfig(), CpuStageTimer())
    stamps_s: list[float] = []
    poses: list[Array] = []
    for frame in frames:
        estimate = odometry.estimate(frame)
        if estimate.ok:
            stamps_s.append(frame.stamp_s)
            poses.append(truth.T_world_camera[0] @ estimate.T_world_camera)
    return Trajectory(np.array(stamps_s), np.array(poses))
