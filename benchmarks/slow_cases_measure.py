"""Whether a camera that stands still is still, and one that creeps is followed."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.camera_frames import all_frames
from benchmarks.hard_cases_measure import follow
from drivers.camera import Pace, RgbdFrame
from drivers.geometry import Array, inverse, rotation_angle_rad
from drivers.tum.camera import TumCamera
from vo_service.evaluation.association import associate
from vo_service.methods import METHODS, FeatureSettings
from vo_service.stage_clock import StageClock


@dataclass(frozen=True)
class StandingStill:
    """How far from the first pose the pose got, at most and in the last frame."""

    frames: int
    lost: int
    farthest_m: float
    farthest_deg: float
    end_m: float
    end_deg: float


@dataclass(frozen=True)
class Creeping:
    """How much of a slow way was followed: from its first pose to its last, along the true way."""

    frames: int
    lost: int
    way_m: float
    followed_m: float


def stand_still(method: str, frames: Iterable[RgbdFrame]) -> StandingStill:
    """Follow a camera that never moves; nothing of a frame is kept."""
    odometry = METHODS[method](FeatureSettings(), StageClock())
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
    return StandingStill(count, lost, *map(float, (*farthest, *end)))


def creep(method: str, folder: Path) -> Creeping:
    """Follow a sequence of the motion "creep". Raises InputError if hardly a frame has a pose."""
    with TumCamera(folder, None, Pace.LOCKSTEP) as camera:
        followed = follow(method, all_frames(camera))
        truth = camera.ground_truth
    assert truth is not None, "a rendered sequence has a truth"
    matched = associate(followed.trajectory, truth)
    true_way = _way_m(matched.T_truth_camera)
    length_m = float(np.linalg.norm(true_way))
    followed_m = float(_way_m(matched.T_world_camera) @ true_way) / length_m
    lost = int(np.count_nonzero(~followed.has_pose))
    return Creeping(len(followed.stamps_s), lost, length_m, followed_m)


def _way_m(T_world_camera: Array) -> Array:
    """(3,) from the first place to the last, in the axes of the first camera."""
    way: Array = (inverse(T_world_camera[0]) @ T_world_camera[-1])[:3, 3]
    return way


def _size(T: Array) -> Array:
    """Metres and degrees of a motion."""
    return np.array([np.linalg.norm(T[:3, 3]), np.degrees(rotation_angle_rad(T[:3, :3]))])
