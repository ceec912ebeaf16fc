"""Errors of one sequence, each divided by the covariance that was told with it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.camera_frames import all_frames
from drivers.camera import Pace
from drivers.errors import InputError
from drivers.geometry import Array, inverse
from drivers.trajectory import StampedPoses, nearest
from drivers.tum.camera import TumCamera
from vo_service.evaluation.association import SAME_STAMP_S
from vo_service.evaluation.consistency import motion_error, normalised_square
from vo_service.methods import METHODS, FeatureSettings
from vo_service.pose_covariance import PoseCovariance
from vo_service.stage_clock import StageClock
from vo_service.types import Estimate


@dataclass
class Squares:
    """Normalised squares of the errors since the reference, and of those of single steps."""

    since: list[float] = field(default_factory=list)
    step: list[float] = field(default_factory=list)

    def add(self, others: "Squares") -> None:
        """Those of another sequence as well."""
        self.since += others.since
        self.step += others.step


class Watcher:
    """Holds the motions of a run against the truth, and keeps the squares."""

    def __init__(self) -> None:
        self.squares = Squares()
        self._covariance = PoseCovariance()
        self._has_begun = False
        self._T_truth_reference = self._T_truth_last = self._T_world_last = np.eye(4)

    def add(self, estimate: Estimate, T_truth_camera: Array) -> None:
        """The next good estimate, and where the camera was."""
        if self._has_begun and not estimate.restarted:
            self._judge(estimate, T_truth_camera)
        else:
            self._covariance.begin()
        if estimate.is_next_reference or not self._has_begun:
            self._T_truth_reference = T_truth_camera
        self._T_truth_last, self._T_world_last = T_truth_camera, estimate.T_world_camera
        self._has_begun = True

    def _judge(self, estimate: Estimate, T_truth_camera: Array) -> None:
        since_true = inverse(self._T_truth_reference) @ T_truth_camera
        since = motion_error(since_true, estimate.T_reference_camera)
        T_last_camera = inverse(self._T_world_last) @ estimate.T_world_camera
        step = motion_error(inverse(self._T_truth_last) @ T_truth_camera, T_last_camera)
        self._covariance.add(estimate, T_last_camera)
        self.squares.since.append(normalised_square(since, estimate.covariance))
        self.squares.step.append(normalised_square(step, self._covariance.step))


def measure(method: str, folder: Path, every: int) -> Squares:
    """Follow one folder. Raises InputError if a frame has no true pose of its own."""
    odometry, watcher = METHODS[method](FeatureSettings(), StageClock()), Watcher()
    with TumCamera(folder, None, Pace.LOCKSTEP) as camera:
        truth = camera.ground_truth
        if truth is None:
            raise InputError(f"{folder}: has no groundtruth.txt to measure errors by")
        for number, frame in enumerate(all_frames(camera)):
            if number % every == 0:
                estimate = odometry.estimate(frame)
                if estimate.ok:
                    watcher.add(estimate, true_pose(truth, frame.stamp_s, folder))
    return watcher.squares


def true_pose(truth: StampedPoses, stamp_s: float, folder: Path) -> Array:
    """4x4 at the stamp of a frame. Raises InputError if there is none, naming the folder."""
    index = int(nearest(truth.stamps_s, np.array([stamp_s]))[0])
    if abs(truth.stamps_s[index] - stamp_s) > SAME_STAMP_S:
        raise InputError(f"{folder}: no true pose at {stamp_s:.6f} s; needs one at every frame")
    T_truth_camera: Array = truth.T_world_camera[index]
    return T_truth_camera
