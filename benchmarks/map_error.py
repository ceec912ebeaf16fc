"""Distance of maps of a virtual room from its true surfaces.

    python -m benchmarks map_error CONFIG RECORDING MAP...

RECORDING was made by `kinect-vo record --config CONFIG`. Each MAP is the output folder of
`kinect-vo reconstruct RECORDING --output MAP`, without a TRAJECTORY. The first pose of a map is
aligned with the true one. Distances are from every vertex to the nearest true surface.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.tracking import read_all_frames
from drivers.camera import PinholeCamera, PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.core.files import cache_folder
from drivers.core.geometry import Array, Trajectory, inverse, read_trajectory, transform_points
from drivers.synthetic import KINECT_COLOR, SyntheticConfig
from drivers.synthetic.camera import RenderOptions, SyntheticCamera
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import CLEARANCE_CHECKS_PER_S
from drivers.synthetic.room import ROOM_HEIGHT_M, build_room
from drivers.synthetic.solids import Solid, SolidKind
from vo_service.config import read_config
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.metrics import associate, first_pose_alignment

GOOD_DISTANCE_M = 0.015
# A vertex of `reconstruct`: position, normal, color.
VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])


def render_with_truth(config: SyntheticConfig) -> Iterator[tuple[RgbdFrame, Array]]:
    """Yield each frame and its true pose T_world_camera in the room."""
    render_options = RenderOptions(cache_folder() / "sequences")
    with SyntheticCamera(config, PlaybackMode.LOCKSTEP, render_options) as camera:
        truth: Trajectory | None = None
        for frame in read_all_frames(camera):
            truth = truth or camera.ground_truth
            assert truth is not None, "a sequence without a loop has a ground truth"
            yield frame, truth.T_world_camera[frame.seq]


def scaled_camera(scale: float) -> PinholeCamera:
    """The virtual Kinect's color camera with scaled images; 1 is 640 x 480."""
    whole = KINECT_COLOR
    return replace(
        whole,
        width=round(scale * whole.width),
        height=round(scale * whole.height),
        fx=scale * whole.fx,
        fy=scale * whole.fy,
        cx=scale * (whole.cx + 0.5) - 0.5,
        cy=scale * (whole.cy + 0.5) - 0.5,
    )


@dataclass(frozen=True)
class SurfaceError:
    """Distances of a map's vertices from the true surface.

    `median_m`, `p90_m` and `p99_m` are percentiles of the distance. `within_15mm` is the fraction
    of the vertices within that distance.
    """

    vertices: int
    median_m: float
    p90_m: float
    p99_m: float
    within_15mm: float

    @classmethod
    def from_vertices(cls, vertices_m: Array, solids: Sequence[Solid]) -> "SurfaceError":
        """Compute the errors of vertices (N, 3) in the room."""
        off_m = distances_m(vertices_m, solids)
        return cls(
            vertices=len(off_m),
            median_m=float(np.median(off_m)),
            p90_m=float(np.percentile(off_m, 90)),
            p99_m=float(np.percentile(off_m, 99)),
            within_15mm=float(np.mean(off_m <= GOOD_DISTANCE_M)),
        )


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


@dataclass(frozen=True)
class MapError:
    """Errors of one map and of its poses."""

    name: str
    ate_rmse_m: float
    surface: SurfaceError

    def __str__(self) -> str:
        surface = self.surface
        distances_m = (surface.median_m, surface.p90_m, surface.p99_m)
        median_mm, p90_mm, p99_mm = (1e3 * m for m in distances_m)
        return (
            f"{self.name}: ATE {1e3 * self.ate_rmse_m:.1f} mm; {surface.vertices} vertices, error "
            f"{median_mm:.1f} mm median, {p90_mm:.1f} mm 90 %, {p99_mm:.1f} mm 99 %; "
            f"{100 * surface.within_15mm:.0f} % within 15 mm"
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("config", metavar="CONFIG", type=Path)
    parser.add_argument("recording", metavar="RECORDING", type=Path)
    parser.add_argument("maps", metavar="MAP", type=Path, nargs="+")


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    solids = make_solids(read_config(args.config).synthetic)
    truth = read_trajectory(args.recording / "groundtruth.txt")
    for folder in args.maps:
        print(measure(folder, truth, solids), flush=True)


def measure(folder: Path, truth: Trajectory, solids: Sequence[Solid]) -> MapError:
    """Measure the error of a map. Raises InputError if there is no map in the folder.

    Args:
        folder: Folder with the map.
        truth: True trajectory.
        solids: True surfaces.
    """
    poses = read_trajectory(folder / "trajectory.txt")
    T_room_map = first_pose_alignment(associate(poses, truth))
    in_room_m = transform_points(T_room_map, read_vertices_m(folder / "map.ply"))
    return MapError(
        name=str(folder),
        ate_rmse_m=evaluate(poses, truth).ate_rmse_m,
        surface=SurfaceError.from_vertices(in_room_m, solids),
    )


def read_vertices_m(path: Path) -> Array:
    """Read the vertices (N, 3) of a mesh of `reconstruct`. Raises InputError for other files."""
    try:
        header, _, body = path.read_bytes().partition(b"end_header\n")
        words = header.split()
        count = int(words[words.index(b"vertex") + 1])
        return np.frombuffer(body, VERTEX, count)["position"].astype(np.float64)
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"{path}: is not a map of `kinect-vo reconstruct`: {error}") from error
