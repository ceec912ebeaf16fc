"""Loops on the caller's own thread: a replay is the same every time."""

from collections.abc import Sequence

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from drivers.core.trajectory import Trajectory
from vo_service.odometry.relocalization import RelocalizationResult, RelocalizingOdometry
from vo_service.slam.loop_closure.loop_closer import KeyframeObservation, LoopCloser
from vo_service.slam.loop_closure.odometry_constraint import ConstraintAccumulator
from vo_service.slam.loop_closure.optimized_trajectory import OptimizedTrajectory
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.types import Odometry, OdometryUpdate, Status


class SynchronousLoopClosure:
    """An output that makes places of the frames, and the finder of a `RelocalizingOdometry`.

    The world of its places is `odom`, as that of the poses that go out.
    """

    warning = ""

    def __init__(self, loop_closer: LoopCloser) -> None:
        self.loop_closer = loop_closer
        self._T_world_odom = np.eye(4)  # from `odom` to the odometry's own world
        self._constraints = ConstraintAccumulator()
        self._last_keyframe: MapKeyframe | None = None  # the last
        self._answers: list[RelocalizationResult] = []
        self._optimized_trajectory = OptimizedTrajectory(loop_closer.graph)
        self.snapshot = loop_closer.snapshot  # as `LoopClosure`

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all good frames in the map as it is known by now; the first is identity."""
        return self._optimized_trajectory.trajectory

    def wrap(self, odometry: Odometry) -> Odometry:
        """As `LoopClosure`."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Take one result; make a place of it where it is one."""
        T_odom_camera, hop = update.T_odom_camera, self._constraints.update(update)
        if hop is not None:
            self._process_keyframe(
                KeyframeObservation(update.frame, update.epoch, T_odom_camera, hop)
            )
        place = self._last_keyframe
        if update.estimate.ok and place is not None and place.world_id == update.epoch:
            self._T_world_odom = update.T_world_camera @ inverse(T_odom_camera)
            T_place_camera = inverse(place.T_world_keyframe) @ T_odom_camera
            self._optimized_trajectory.add(update.frame.stamp_s, place.number, T_place_camera)

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def close(self) -> None:
        """No more frames come: the last loops count as well."""
        self.loop_closer.optimize()
        self.snapshot = self.loop_closer.snapshot

    @property
    def has_map(self) -> bool:
        """As `Relocalizer`."""
        return len(self.loop_closer.database) > 0

    def query(self, frame: RgbdFrame) -> None:
        """As `Relocalizer`."""
        located = self.loop_closer.relocalize(frame)
        if located is not None:
            self._answers.append(located.transform_to(self._T_world_odom))

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """As `Relocalizer`."""
        answers, self._answers = self._answers, []
        return answers

    def _process_keyframe(self, observation: KeyframeObservation) -> None:
        change = self.loop_closer.process_keyframe(observation)
        for removal in change.removals:
            self._optimized_trajectory.re_anchor(removal)
        self._last_keyframe = change.keyframe
        self.snapshot = self.loop_closer.snapshot
