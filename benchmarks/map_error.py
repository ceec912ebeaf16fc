"""Distance of maps of a virtual room from its true surfaces.

    python -m benchmarks.map_error CONFIG RECORDING MAP...

RECORDING was made by `kinect-vo record --config CONFIG`. Each MAP is the output folder of
`kinect-vo reconstruct RECORDING --output MAP`, without a TRAJECTORY. The first pose of a map is
aligned with the true one. Distances are from every vertex to the nearest true surface.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.surface_error import SurfaceError, make_solids
from drivers.core.errors import InputError, UserFacingError
from drivers.core.geometry import Array, transform_points
from drivers.core.trajectory import Trajectory, read_trajectory
from drivers.synthetic.solids import Solid
from vo_service.config import read_config
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.metrics import first_pose_alignment

# A vertex of `reconstruct`: position, normal, color.
VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])


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


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.map_error",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", metavar="CONFIG", type=Path)
    parser.add_argument("recording", metavar="RECORDING", type=Path)
    parser.add_argument("maps", metavar="MAP", type=Path, nargs="+")
    args = parser.parse_args()
    try:
        solids = make_solids(read_config(args.config).synthetic)
        truth = read_trajectory(args.recording / "groundtruth.txt")
        for folder in args.maps:
            print(measure(folder, truth, solids), flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def measure(folder: Path, truth: Trajectory, solids: Sequence[Solid]) -> MapError:
    """Measure the error of a map. Raises InputError if there is no map in the folder."""
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


if __name__ == "__main__":
    sys.exit(main())
