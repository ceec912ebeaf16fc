"""Errors of one sequence, normalized by their reported covariance."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.camera_frames import read_all_frames
from drivers.camera import PlaybackMode
from drivers.core.errors import InputError
from drivers.core.geometry import Array, inverse
from drivers.core.trajectory import Trajectory, nearest_indices
from drivers.tum.camera import TumCamera
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.uncertainty import CovarianceAccumulator
from vo_service.tools.evaluation.association import STAMP_ROUNDING_S
from vo_service.tools.evaluation.consistency import motion_error, nees
from vo_service.types import Estimate


@dataclass
class NormalizedErrors:
    """Normalized squared errors (NEES) since the reference, and of single steps."""

    since_reference: list[float] = field(default_factory=list)
    step: list[float] = field(default_factory=list)

    def extend(self, others: "NormalizedErrors") -> None:
        """Append the errors of another sequence."""
        self.since_reference += others.since_reference
        self.step += others.step


class NormalizedErrorCollector:
    """Compares the motions of a run with the truth and collects the normalized errors."""

    def __init__(self) -> None:
        self.squares = NormalizedErrors()
        self._covariance = CovarianceAccumulator()
        self._has_begun = False
        self._T_truth_reference = self._T_truth_last = self._T_world_last = np.eye(4)

    def add(self, estimate: Estimate, T_truth_camera: Array) -> None:
        """Add the next good estimate and the true pose."""
        if self._has_begun and not estimate.is_reset:
            self._add_errors(estimate, T_truth_camera)
        else:
            self._covariance.reset()
        if estimate.is_next_reference or not self._has_begun:
            self._T_truth_reference = T_truth_camera
        self._T_truth_last, self._T_world_last = T_truth_camera, estimate.T_world_camera
        self._has_begun = True

    def _add_errors(self, estimate: Estimate, T_truth_camera: Array) -> None:
        since_true = inverse(self._T_truth_reference) @ T_truth_camera
        since = motion_error(since_true, estimate.T_reference_camera)
        T_last_camera = inverse(self._T_world_last) @ estimate.T_world_camera
        step = motion_error(inverse(self._T_truth_last) @ T_truth_camera, T_last_camera)
        self._covariance.add(estimate, T_last_camera)
        self.squares.since_reference.append(nees(since, estimate.covariance))
        self.squares.step.append(nees(step, self._covariance.step))


def measure(method: str, folder: Path, every: int) -> NormalizedErrors:
    """Run a method on every `every`-th frame of a TUM folder.

    Raises:
        InputError: A frame has no true pose.
    """
    odometry, collector = (
        METHODS[method](MethodConfig(), CpuStageTimer()),
        NormalizedErrorCollector(),
    )
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        truth = camera.ground_truth
        if truth is None:
            raise InputError(f"{folder}: has no groundtruth.txt; errors need a ground truth")
        for number, frame in enumerate(read_all_frames(camera)):
            if number % every == 0:
                estimate = odometry.estimate(frame)
                if estimate.ok:
                    collector.add(estimate, true_pose(truth, frame.stamp_s, folder))
    return collector.squares


def true_pose(truth: Trajectory, stamp_s: float, folder: Path) -> Array:
    """Return the true pose (4, 4) of a frame. Raises InputError if there is none."""
    index = int(nearest_indices(truth.stamps_s, np.array([stamp_s]))[0])
    if abs(truth.stamps_s[index] - stamp_s) > STAMP_ROUNDING_S:
        raise InputError(f"{folder}: no true pose at {stamp_s:.6f} s; every frame needs one")
    T_truth_camera: Array = truth.T_world_camera[index]
    return T_truth_camera
