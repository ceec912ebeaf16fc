"""Scan and occupancy grid of a robot in virtual rooms, against what a sensor without noise sees."""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import tee

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.changed_recordings import make_perturbation
from benchmarks.harness import Table, Variants, measure_cpu_ms, median, option
from benchmarks.rendered_sequences import GivenPoses, make_frame, prefetch
from benchmarks.tracking import track_each
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from drivers.synthetic.camera_motion import CameraMotion, make_poses
from drivers.synthetic.config import ShutterTiming, SyntheticConfig
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.solids import SolidArrays, SolidKind
from tests.vo_service.navigation.views import mounted
from vo_service.config_tables import ScanConfig
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.navigation.grid_recorder import FRAME_STEP, GridRecorder
from vo_service.navigation.robot_scan import RobotScanner
from vo_service.navigation.scan import ScanAngles
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.registry import DEFAULT_METHOD, METHODS, MethodConfig
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.odometry.warm_up import warm_up
from vo_service.types.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

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
SCAN_TABLE = Table(
    *(14, "p50 cm:8.1f", "p95 cm:8.1f", "phantoms %:12.2f", "missed %:10.2f", "2 deg %:10.2f"),
    "ms:7.2f",
)
CELL_COLUMNS = ("precision %:13.1f", "recall %:10.1f", "free %:8.1f", "in solids %:13.2f")
# With a wrong tilt, what is this high is no longer floor.
FLOOR_M = 0.03
# Of the grid: the defaults of the configuration.
RESOLUTION_M, RANGE_MAX_M = 0.05, 4.0
ROOM_SEED = 11


class VirtualRoom:
    """A virtual room, and the camera of a base that moves in it."""

    def __init__(self, config: SyntheticConfig, motion: CameraMotion) -> None:
        without_noise = replace(
            config.depth, disparity_step_px=0.0, disparity_sigma_px=0.0, lateral_sigma_px=0.0
        )
        exact = replace(config, depth=without_noise, timing=ShutterTiming(0.0, 0.0))
        room = RoomModel.build(config, motion, 1)
        self.solids = room.solids
        self.renderer = Renderer(config, motion, room)
        self._config, self._exact = config, Renderer(exact, motion, room)

    def measured(self, number: int) -> RgbdFrame:
        """Render a frame without color."""
        return self._frame(self.renderer.render_depth(number))

    def exact(self, number: int) -> RgbdFrame:
        """Render it without noise, and with all rows at the stamp."""
        return self._frame(self._exact.render_depth(number))

    def _frame(self, depth_raw: NDArray[np.uint16]) -> RgbdFrame:
        color, config = np.zeros((*depth_raw.shape, 3), np.uint8), self._config
        return RgbdFrame(0, 0.0, 0.0, color, depth_raw, config.depth_factor, config.camera)


def make_room(T_world_camera: Array) -> VirtualRoom:
    """Make a room with a frame for each pose (N, 4, 4)."""
    config = SyntheticConfig(
        seed=ROOM_SEED,
        texel_m=0.05,
        rate_hz=1.0,
        duration_s=float(len(T_world_camera)),
        timing=ShutterTiming(0.0, 0.0),
    )
    return VirtualRoom(config, GivenPoses(T_world_camera, 1.0))


def points_in_base(frame: RgbdFrame, T_base_camera: Array) -> Array:
    """(N, 3) points of all pixels with depth."""
    camera = frame.camera
    v, u = np.nonzero(frame.depth_raw)
    z = frame.depth_raw[v, u] / frame.depth_factor
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    in_base: Array = points @ T_base_camera[:3, :3].T + T_base_camera[:3, 3]
    return in_base


def true_ranges(
    points: Array, angles: ScanAngles, min_m: Array, top_m: float, least_m: float
) -> Array:
    """Range of the nearest obstacle by direction; NaN = none, or nearer than `least_m`.

    Args:
        points: (N, 3) in the base, x as the camera looks.
        min_m: (N,) least height of an obstacle at each of them.
        top_m: Largest height.
        least_m: Least range that can be told.
    """
    ranges = np.hypot(points[:, 0], points[:, 1])
    directions = np.arctan2(points[:, 1], points[:, 0])
    bins = np.floor((directions - angles.first_rad) / angles.step_rad + 0.5).astype(int)
    is_obstacle = (points[:, 2] >= min_m) & (points[:, 2] <= top_m)
    nearest = np.full(angles.bins, np.nan)
    for number in range(angles.bins):
        inside = np.sort(ranges[is_obstacle & (bins == number)])
        if len(inside) >= TRUE_PIXELS and inside[TRUE_PIXELS - 1] >= least_m:
            nearest[number] = inside[TRUE_PIXELS - 1]
    return nearest


@option("--views", type=int, default=24, help="of each mounting")
def scan(args: argparse.Namespace) -> None:
    """Measure the scan's error, phantoms and misses.

    A phantom is nearer by more than 10 cm than what a noise-free sensor measures there; a miss is
    an obstacle with no range at all. With a wrong tilt, only what is floor is a phantom.
    """
    print(SCAN_TABLE.head)
    config = ScanConfig()
    for height_m, down_deg in MOUNTINGS:
        T_base_camera = mounted(height_m, down_deg)
        errors: list[float] = []
        counts = np.zeros(4)  # ranges, phantoms, misses, phantoms with a wrong tilt
        times_ms = []
        room = make_room(_random_places(args.views) @ T_base_camera)
        for number in range(args.views):
            measured, exact = room.measured(number), room.exact(number)
            scanner = RobotScanner(config, T_base_camera)
            angles, ranges = scanner.scan(measured, T_base_camera)
            again = partial(scanner.scan, measured, T_base_camera)
            times_ms.append(measure_cpu_ms(again)[1])
            points = points_in_base(exact, T_base_camera)
            along_m = np.hypot(points[:, 0], points[:, 1])
            rising = config.min_height_m + np.tan(np.radians(1.0)) * along_m
            truth = true_ranges(points, angles, rising, height_m + 0.15, config.range_min_m)
            errors.extend(np.abs(ranges - truth)[np.isfinite(ranges) & np.isfinite(truth)])
            R_tilt = so3_exp([0.0, np.radians(-2.0), 0.0])
            tilted = rigid_transform(R_tilt @ T_base_camera[:3, :3], T_base_camera[:3, 3])
            leaked = scanner.scan(measured, tilted)[1]
            # The tilt may move what is too near to be told beyond the least range.
            floor = np.full(len(points), FLOOR_M)
            surface = true_ranges(points, angles, floor, height_m + 0.3, 0.0)
            counts += np.array(
                [
                    angles.bins,
                    count_phantoms(ranges, truth),
                    np.count_nonzero(~np.isfinite(ranges) & (truth < config.range_max_m)),
                    count_phantoms(leaked, surface),
                ]
            )
        shares = 100.0 * counts[1:] / counts[0]
        spread = 100.0 * np.percentile(errors, (50, 95))
        name = f"{height_m:g} m, {down_deg:g} deg"
        print(SCAN_TABLE.row(name, *spread, *shares, float(np.median(times_ms))), flush=True)


def count_phantoms(ranges: NDArray[np.float32], truth: Array) -> int:
    """Count ranges that are nearer than the true ones, or where there is none."""
    is_phantom = (ranges < truth - PHANTOM_M) | (np.isfinite(ranges) & np.isnan(truth))
    return int(np.count_nonzero(is_phantom))


def _random_places(count: int) -> Array:
    rng = np.random.default_rng(7)
    places = []
    for _ in range(count):
        position = (rng.uniform(-1.5, 1.5), rng.uniform(-1.2, 1.2), 0.0)
        places.append(rigid_transform(so3_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), position))
    return np.array(places)


# Cameras of the drives: height, m, and how far it looks down, degrees.
DRIVES = ((0.6, 10.0), (0.3, 0.0), (1.35, 25.0))
DRIVE_RADIUS_M = 1.5
# Of what the exact images have of a cell, so much makes it occupied.
TRUE_CELL_PIXELS = 8
REPEATED_KEYFRAMES = 1000


@option("--keyframes", type=int, default=72, help="of each drive")
def grid(args: argparse.Namespace) -> None:
    """Measure the occupancy grid of a drive in a circle, against exact images and the room.

    Precision and recall are within one cell. Free is the share of the floor in view that the grid
    has as free; in solids, the share of its free cells that are inside of furniture or walls.
    """
    table = Table(14, *CELL_COLUMNS, "cells:8d", "frame ms:10.2f", "1000 ms:9.1f")
    print(table.head)
    for height_m, down_deg in DRIVES:
        T_base_camera = mounted(height_m, down_deg)
        T_world_bases = _drive(args.keyframes)
        room = make_room(T_world_bases @ T_base_camera)
        drawing = GridMapper(ScanConfig(), T_base_camera, RESOLUTION_M, RANGE_MAX_M)
        truth = TrueCells()
        frames, times_ms = [], []
        for number, T_world_base in enumerate(T_world_bases):
            measured, T_world_camera = room.measured(number), T_world_base @ T_base_camera
            drawing.cells(measured, T_world_camera)
            seen, cpu_ms = measure_cpu_ms(partial(drawing.cells, measured, T_world_camera))
            frames.append((seen, T_world_camera))
            times_ms.append(cpu_ms)
            points = points_in_base(room.exact(number), T_base_camera)
            truth.add(points, T_world_base, height_m + 0.15)
        result = drawing.render(frames)
        figures = truth.compare(result, room.solids, height_m + 0.15)
        many = -(-REPEATED_KEYFRAMES // len(frames))
        _, cpu_ms = measure_cpu_ms(partial(drawing.render, frames * many))
        render_ms = cpu_ms * REPEATED_KEYFRAMES / (many * len(frames))
        count = int(np.mean([len(seen) for seen, _ in frames]))
        name = f"{height_m:g} m, {down_deg:g} deg"
        times = float(np.median(times_ms)), render_ms
        print(table.row(name, *(100.0 * each for each in figures), count, *times), flush=True)


def _drive(count: int) -> Array:
    """A circle, in which the base looks ahead and to the sides in turn."""
    poses = []
    for number in range(count):
        angle = 2.0 * np.pi * number / count
        position = (DRIVE_RADIUS_M * np.cos(angle), DRIVE_RADIUS_M * np.sin(angle), 0.0)
        yaw = angle + np.pi / 2 + (0.0, 1.0, -1.0, 2.2)[number % 4]
        poses.append(rigid_transform(so3_exp([0.0, 0.0, yaw]), position))
    return np.array(poses)


# The drive whose poses are estimated: a round in a circle, while the view swings to the sides.
TURN_RAD_S, SWING_RAD, SWINGS = 0.2, 1.0, 3
DRIVE_RATE_HZ = 15.0
# Largest loss of precision, recall or free floor by estimated poses.
MAX_LOSS = 0.01


class RoundTrip(CameraMotion):
    """A base that drives a circle."""

    duration_s = 2.0 * np.pi / TURN_RAD_S

    def __init__(self, height_m: float, down_deg: float) -> None:
        self._height_m, self._down_rad = height_m, np.radians(down_deg)

    def poses(self, times_s: Array) -> Array:
        angle = TURN_RAD_S * times_s
        x, y = DRIVE_RADIUS_M * np.cos(angle), DRIVE_RADIUS_M * np.sin(angle)
        position = np.stack([x, y, np.full_like(x, self._height_m)], axis=1)
        yaw = angle + SWING_RAD * np.sin(SWINGS * angle)
        return make_poses(position, yaw, np.full_like(yaw, self._down_rad), np.zeros_like(yaw))


# Tiny changes of the frames: each is a run of its own, and a figure is the median of all runs.
PERTURBATION_COUNT = 5


def poses(args: argparse.Namespace) -> int:
    """Compare the grid by estimated poses of a drive in a circle with that by true poses.

    Figures are those of `grid`; "error" is the largest of a position in the state `tracking`. They
    are medians of five runs with tiny changes of the frames. Exit code 1 if estimated poses cost
    more than one percentage point. It takes ten minutes.
    """
    warm_up(DEFAULT_METHOD, lambda stage: None)
    table = Table(26, *CELL_COLUMNS, "frames:8.0f", "error mm:10.1mm", "bar:6")
    print(table.head)
    exit_code = 0
    for height_m, down_deg in DRIVES:
        by_true, by_estimated, errors_m = compare_poses(height_m, down_deg)
        losses = np.median(by_true[:, :3], axis=0) - np.median(by_estimated[:, :3], axis=0)
        is_good = losses.max() <= MAX_LOSS
        exit_code |= not is_good
        name = f"{height_m:g} m, {down_deg:g} deg"
        for kind, figures, error_m, verdict in (
            ("true", by_true, None, None),
            ("estimated", by_estimated, median(errors_m), "pass" if is_good else "FAIL"),
        ):
            *shares, count = np.median(figures, axis=0)
            cells = [100.0 * each for each in shares]
            print(table.row(f"{name}: {kind}", *cells, count, error_m, verdict), flush=True)
    return exit_code


def compare_poses(height_m: float, down_deg: float) -> tuple[Array, Array, list[float]]:
    """Drive with a camera, once for each perturbation of the frames.

    Returns:
        By run, the figures of the grid by true poses and of that by estimated poses, each with its
        number of frames, and the largest error of a position in the state `tracking`, m.
    """
    motion, T_base_camera = RoundTrip(height_m, down_deg), mounted(height_m, down_deg)
    fast = replace(SyntheticConfig.fast(), seed=ROOM_SEED, loop=False, rate_hz=DRIVE_RATE_HZ)
    config = replace(fast, duration_s=motion.duration_s)
    room = VirtualRoom(config, motion)
    mapper = GridMapper(ScanConfig(), T_base_camera, RESOLUTION_M, RANGE_MAX_M)
    runs, truth = [DriveRun(mapper, T_base_camera) for _ in range(PERTURBATION_COUNT)], TrueCells()
    frames = (
        make_frame(config, seq, seq / DRIVE_RATE_HZ, images)
        for seq, images in enumerate(prefetch(room.renderer.render, config.frame_count))
    )
    tracked = (
        run.track(map(make_perturbation(seed).apply, each))
        for seed, (run, each) in enumerate(zip(runs, tee(frames, len(runs)), strict=True))
    )
    for updates in zip(*tracked, strict=True):
        seq = updates[0].seq
        T_true = motion.poses(np.array([updates[0].stamp_s]))[0]
        for run, update in zip(runs, updates, strict=True):
            run.add(update, T_true)
        if seq % FRAME_STEP == 0:
            points = points_in_base(room.exact(seq), T_base_camera)
            truth.add(points, T_true @ inverse(T_base_camera), height_m + 0.15)
    by_true, by_estimated = (
        np.array(
            [
                (*truth.compare(each.render(), room.solids, height_m + 0.15), each.frame_count)
                for each in recorders
            ]
        )
        for recorders in zip(*(run.recorders for run in runs), strict=True)
    )
    return by_true, by_estimated, [max(run.errors_m) for run in runs]


class DriveRun:
    """An odometry's run along a drive, and the grids by true and by estimated poses."""

    def __init__(self, mapper: GridMapper, T_base_camera: Array) -> None:
        self.recorders = GridRecorder(mapper), GridRecorder(mapper)
        self.errors_m: list[float] = []
        self._T_base_camera = T_base_camera
        self._T_world_odom = np.eye(4)

    def track(self, frames: Iterable[RgbdFrame]) -> Iterator[OdometryUpdate]:
        """Yield the update of each frame."""
        odometry = METHODS[DEFAULT_METHOD](MethodConfig(), CpuStageTimer())
        for update, _ in track_each(odometry, frames, OdomFrame(self._T_base_camera, True)):
            yield update

    def add(self, update: OdometryUpdate, T_true: Array) -> None:
        """Add a frame to both grids. `T_true` is the camera's true pose in the world."""
        if update.seq == 0:
            self._T_world_odom = T_true @ inverse(self._T_base_camera) @ inverse(update.T_odom_base)
        T_estimated = self._T_world_odom @ update.T_odom_camera
        if update.state is TrackingState.TRACKING:  # the grid has no others
            self.errors_m.append(float(np.linalg.norm(T_estimated[:3, 3] - T_true[:3, 3])))
        for recorder, T_world_camera in zip(self.recorders, (T_true, T_estimated), strict=True):
            recorder.on_update(replace(update, T_odom_camera=T_world_camera))


class TrueCells:
    """What exact images show of the cells around the world's origin, on a fixed grid."""

    size = 400  # cells along each side

    def __init__(self) -> None:
        self.obstacles = np.zeros((self.size, self.size), np.int64)
        self.any_obstacle = np.zeros((self.size, self.size), np.bool_)
        self.floor = np.zeros((self.size, self.size), np.bool_)

    def add(self, points: Array, T_world_base: Array, top_m: float) -> None:
        """Add the points (N, 3) of a frame in its base."""
        points = points[np.hypot(points[:, 0], points[:, 1]) < RANGE_MAX_M]
        in_world = points @ T_world_base[:3, :3].T + T_world_base[:3, 3]
        column, row = np.floor(in_world[:, :2] / RESOLUTION_M).astype(int).T + self.size // 2
        height = in_world[:, 2]
        along_m = np.hypot(points[:, 0], points[:, 1])
        least_m = ScanConfig().min_height_m + np.tan(np.radians(1.0)) * along_m
        counts = np.zeros_like(self.obstacles)
        inside = (height >= least_m) & (height <= top_m)
        np.add.at(counts, (row[inside], column[inside]), 1)
        self.obstacles = np.maximum(self.obstacles, counts)
        inside = (height >= FLOOR_M) & (height <= top_m + FLOOR_M)
        self.any_obstacle[row[inside], column[inside]] = True
        inside = np.abs(height) < 0.01
        self.floor[row[inside], column[inside]] = True

    def compare(
        self, result: OccupancyGrid, solids: SolidArrays, top_m: float
    ) -> tuple[float, float, float, float]:
        """Return precision, recall, share of the seen floor that is free, free cells in solids."""
        cells = np.full((self.size, self.size), UNKNOWN, np.int8)
        column, row = np.rint(np.array(result.origin_xy_m) / RESOLUTION_M).astype(int)
        column, row = column + self.size // 2, row + self.size // 2
        height, width = result.cells.shape
        cells[row : row + height, column : column + width] = result.cells
        occupied, true = cells == OCCUPIED, self.obstacles >= TRUE_CELL_PIXELS
        precision = np.mean(_grow(self.any_obstacle)[occupied])
        recall = np.mean(_grow(occupied)[true])
        free = np.mean((cells == FREE)[self.floor & ~_grow(true)])
        inside = ~_grow(~self._solid(solids, top_m))
        return float(precision), float(recall), float(free), float(np.mean(inside[cells == FREE]))

    def _solid(self, solids: SolidArrays, top_m: float) -> NDArray[np.bool_]:
        """Cells whose middle is inside of a solid, at the height of an obstacle."""
        axis = (np.arange(self.size) - self.size // 2 + 0.5) * RESOLUTION_M
        is_solid = np.zeros((self.size, self.size), np.bool_)
        for height_m in np.arange(0.15, top_m, 0.05):
            y, x = np.meshgrid(axis, axis, indexing="ij")
            points = np.stack([x, y, np.full_like(x, height_m)], axis=-1)
            for kind, to_unit, center in zip(
                solids.kind, solids.to_unit, solids.center_m, strict=True
            ):
                unit = (points - center) @ to_unit.T
                if kind == SolidKind.SPHERE:
                    inside = np.linalg.norm(unit, axis=-1) <= 1.0
                elif kind == SolidKind.CYLINDER:
                    inside = (np.hypot(unit[..., 0], unit[..., 1]) <= 1.0) & (
                        abs(unit[..., 2]) <= 1.0
                    )
                else:
                    inside = np.abs(unit).max(axis=-1) <= 1.0
                is_solid |= ~inside if kind == SolidKind.ROOM else inside
        return is_solid


def _grow(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Add the neighbors of all cells."""
    return cv2.dilate(cells.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)


VARIANTS: Variants = {
    "scan": scan,
    "grid": grid,
    "poses": poses,
}
