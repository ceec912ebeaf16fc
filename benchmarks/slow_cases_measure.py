"""Drift of a stationary camera, and tracking of a creeping one."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.camera_frames import read_all_frames
from benchmarks.hard_cases_measure import track
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.geometry import Array, inverse, rotation_angle_rad
from drivers.tum.camera import TumCamera
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.tools.evaluation.association import associate


@dataclass(frozen=True)
class StationaryResult:
    """Distance from the first pose, at most and in the last frame."""

    frames: int
    lost: int
    max_error_m: float
    max_error_deg: float
    end_m: float
    end_deg: float


@dataclass(frozen=True)
class CreepResult:
    """Tracked distance of a slow motion, projected onto the true motion, and the true distance."""

    frames: int
    lost: int
    true_distance_m: float
    tracked_distance_m: float


def measure_stationary(method: str, frames: Iterable[RgbdFrame]) -> StationaryResult:
    """Track a camera that never moves, without storing its frames."""
    odometry = METHODS[method](MethodConfig(), CpuStageTimer())
    lost, count = 0, 0
    farthest, end = np.zeros(2), np.zeros(2)
    T_camera_first = np.eye(4)
    for frame in frames:
        estimate = odometry.estimate(frame)
        count += 1
        if not estimate.ok:
            lost += 1
            continue
        if count == lost + 1:
            T_camera_first = inverse(estimate.T_world_camera)
        end = _size(T_camera_first @ estimate.T_world_camera)
        farthest = np.maximum(farthest, end)
    return StationaryResult(count, lost, *map(float, (*farthest, *end)))


def measure_creep(method: str, folder: Path) -> CreepResult:
    """Track a sequence of the motion "creep". Raises InputError with too few poses."""
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        tracked = track(method, read_all_frames(camera))
        truth = camera.ground_truth
    assert truth is not None, "a rendered sequence has a ground truth"
    matched = associate(tracked.trajectory, truth)
    true_way = _displacement_m(matched.T_truth_camera)
    length_m = float(np.linalg.norm(true_way))
    followed_m = float(_displacement_m(matched.T_world_camera) @ true_way) / length_m
    lost = int(np.count_nonzero(~tracked.has_pose))
    return CreepResult(len(tracked.stamps_s), lost, length_m, followed_m)


def _displacement_m(T_world_camera: Array) -> Array:
    """Displacement (3,) from the first pose to the last, in the axes of the first camera."""
    displacement_m: Array = (inverse(T_world_camera[0]) @ T_world_camera[-1])[:3, 3]
    return displacement_m


def _size(T: Array) -> Array:
    """Distance in meters and angle in degrees of a motion."""
    return np.array([np.linalg.norm(T[:3, 3]), np.degrees(rotation_angle_rad(T[:3, :3]))])
