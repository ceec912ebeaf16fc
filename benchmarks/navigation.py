"""Scan and occupancy grid of a robot in virtual rooms, against what a noise-free sensor measures.

python -m benchmarks navigation scan          ranges from cameras of several heights and tilts
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table
from drivers.camera import RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, Array, rigid_transform, so3_exp
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import ShutterTiming, SyntheticConfig
from drivers.synthetic.renderer import Renderer, RoomModel
from vo_service.config_tables import ScanConfig
from vo_service.navigation.robot_scan import RobotScanner
from vo_service.navigation.scan import ScanAngles

# Height of the camera, m, and how far it looks down, degrees.
MOUNTINGS = (
    (0.3, 0.0),
    (0.3, 10.0),
    (0.5, 0.0),
    (0.5, 10.0),
    (0.5, 25.0),
    (1.0, 0.0),
    (1.0, 10.0),
    (1.0, 25.0),
    (1.5, 0.0),
    (1.5, 25.0),
)
# A range that is nearer by more is a phantom.
PHANTOM_M = 0.10
# Pixels of an obstacle in the true image, which is not thinned out.
TRUE_PIXELS = 8
# With a wrong tilt, what is this high is no longer floor.
FLOOR_M = 0.03


class FixedPoses(CameraMotion):
    """Given poses of the camera, one a second."""

    def __init__(self, T_world_camera: Array) -> None:
        self._poses = T_world_camera

    def poses(self, times_s: Array) -> Array:
        numbers = np.rint(times_s).astype(int)
        poses: Array = self._poses[np.clip(numbers, 0, len(self._poses) - 1)]
        return poses


def mounting_pose(height_m: float, down_deg: float) -> Array:
    """4x4 pose of the optical camera in the base."""
    R = so3_exp([0.0, np.radians(down_deg), 0.0])
    return rigid_transform(R, (0.0, 0.0, height_m)) @ T_BODY_CAMERA


@dataclass(frozen=True)
class DepthPair:
    """A frame of the virtual Kinect without color, and the same without noise."""

    T_world_base: Array
    measured: RgbdFrame
    exact: RgbdFrame


def render_depth(
    T_world_base: Array, T_base_camera: Array, config: SyntheticConfig
) -> Iterator[DepthPair]:
    """Render depth from poses of the base (N, 4, 4) in the room of a configuration."""
    motion = FixedPoses(T_world_base @ T_base_camera)
    config = replace(
        config,
        texel_m=0.05,
        rate_hz=1.0,
        duration_s=float(len(T_world_base)),
        timing=ShutterTiming(0.0, 0.0),
    )
    exact_depth = replace(
        config.depth, disparity_step_px=0.0, disparity_sigma_px=0.0, lateral_sigma_px=0.0
    )
    room = RoomModel.build(config, motion, 1)
    measured = Renderer(config, motion, room)
    exact = Renderer(replace(config, depth=exact_depth), motion, room)
    for number, pose in enumerate(T_world_base):
        yield DepthPair(
            pose,
            _frame(config, measured.render_depth(number)),
            _frame(config, exact.render_depth(number)),
        )


def _frame(config: SyntheticConfig, depth_raw: NDArray[np.uint16]) -> RgbdFrame:
    color = np.zeros((*depth_raw.shape, 3), np.uint8)
    return RgbdFrame(0, 0.0, 0.0, color, depth_raw, config.depth_factor, config.camera)


def points_in_base(frame: RgbdFrame, T_base_camera: Array) -> Array:
    """(N, 3) points of all pixels with depth."""
    camera = frame.camera
    v, u = np.nonzero(frame.depth_raw)
    z = frame.depth_raw[v, u] / frame.depth_factor
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    in_base: Array = points @ T_base_camera[:3, :3].T + T_base_camera[:3, 3]
    return in_base


def true_ranges(points: Array, angles: ScanAngles, min_m: Array, top_m: float) -> Array:
    """Range of the nearest obstacle by direction; NaN = none, or nearer than can be told.

    Args:
        points: (N, 3) in the base, x as the camera looks.
        min_m: (N,) least height of an obstacle at each of them.
        top_m: Largest height.
    """
    ranges = np.hypot(points[:, 0], points[:, 1])
    directions = np.arctan2(points[:, 1], points[:, 0])
    bins = np.floor((directions - angles.first_rad) / angles.step_rad + 0.5).astype(int)
    is_obstacle = (points[:, 2] >= min_m) & (points[:, 2] <= top_m)
    nearest = np.full(angles.bins, np.nan)
    for number in range(angles.bins):
        inside = np.sort(ranges[is_obstacle & (bins == number)])
        if len(inside) >= TRUE_PIXELS and inside[TRUE_PIXELS - 1] >= ScanConfig().range_min_m:
            nearest[number] = inside[TRUE_PIXELS - 1]
    return nearest


def add_scan_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--views", type=int, default=24, help="of each mounting")
    parser.add_argument("--seed", type=int, default=11, help="of the room")


def scan(args: argparse.Namespace) -> None:
    """Measure the scan's error, phantoms and misses.

    A phantom is nearer by more than 10 cm than what a noise-free sensor measures there; a miss is
    an obstacle with no range at all. With a wrong tilt, only what is floor is a phantom.
    """
    columns = "p50 cm:8.1f", "p95 cm:8.1f", "phantoms %:12.2f", "missed %:10.2f", "2 deg %:10.2f"
    table = Table(14, *columns, "ms:7.2f")
    print(table.head)
    config = ScanConfig()
    for height_m, down_deg in MOUNTINGS:
        T_base_camera = mounting_pose(height_m, down_deg)
        errors: list[float] = []
        counts = np.zeros(4)  # ranges, phantoms, misses, phantoms with a wrong tilt
        times_ms = []
        for pair in render_depth(_random_places(args.views), T_base_camera, _room(args.seed)):
            scanner = RobotScanner(config, T_base_camera)
            angles, ranges = scanner.scan(pair.measured, np.eye(4))
            begin_s = time.perf_counter()
            scanner.scan(pair.measured, np.eye(4))
            times_ms.append(1e3 * (time.perf_counter() - begin_s))
            points = points_in_base(pair.exact, T_base_camera)
            along_m = np.hypot(points[:, 0], points[:, 1])
            rising = config.min_height_m + np.tan(np.radians(1.0)) * along_m
            truth = true_ranges(points, angles, rising, height_m + 0.15)
            is_told = np.isfinite(ranges) & np.isfinite(truth)
            errors.extend(np.abs(ranges - truth)[is_told])
            tilted = rigid_transform(so3_exp([0.0, np.radians(-2.0), 0.0]), np.zeros(3))
            leaked = scanner.scan(pair.measured, tilted)[1]
            surface = true_ranges(points, angles, np.full(len(points), FLOOR_M), height_m + 0.3)
            counts += np.array(
                [
                    angles.bins,
                    np.count_nonzero(is_told & (ranges < truth - PHANTOM_M))
                    + np.count_nonzero(np.isfinite(ranges) & np.isnan(truth)),
                    np.count_nonzero(~np.isfinite(ranges) & (truth < config.range_max_m)),
                    np.count_nonzero(leaked < surface - PHANTOM_M)
                    + np.count_nonzero(np.isfinite(leaked) & np.isnan(surface)),
                ]
            )
        shares = 100.0 * counts[1:] / counts[0]
        spread = 100.0 * np.percentile(errors, (50, 95))
        name = f"{height_m:g} m, {down_deg:g} deg"
        print(table.row(name, *spread, *shares, float(np.median(times_ms))), flush=True)


def _room(seed: int) -> SyntheticConfig:
    return replace(SyntheticConfig(), seed=seed)


def _random_places(count: int) -> Array:
    rng = np.random.default_rng(7)
    places = []
    for _ in range(count):
        position = (rng.uniform(-1.5, 1.5), rng.uniform(-1.2, 1.2), 0.0)
        places.append(rigid_transform(so3_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), position))
    return np.array(places)


VARIANTS = {"scan": (add_scan_arguments, scan)}
