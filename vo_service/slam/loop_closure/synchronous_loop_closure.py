"""Loop closure on the caller's thread: a replay is deterministic."""

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
    """Output that makes keyframes of the frames, and relocalizer of a `RelocalizingOdometry`.

    The world frame of its keyframes is `odom`, as that of the published poses.
    """

    warning = ""

    def __init__(self, loop_closer: LoopCloser) -> None:
        self.loop_closer = loop_closer
        self._T_world_odom = np.eye(4)  # from `odom` to the odometry's world frame
        self._constraints = ConstraintAccumulator()
        self._last_keyframe: MapKeyframe | None = None
        self._results: list[RelocalizationResult] = []
        self._optimized_trajectory = OptimizedTrajectory(loop_closer.graph)
        self.snapshot = loop_closer.snapshot

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all good frames by the current map; the first is the identity."""
        return self._optimized_trajectory.trajectory

    def wrap(self, odometry: Odometry) -> Odometry:
        """Wrap the odometry so that it relocalizes after a loss."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Add a result; make it a keyframe if it is selected."""
        T_odom_camera, constraint = update.T_odom_camera, self._constraints.update(update)
        if constraint is not None:
            self._process_keyframe(
                KeyframeObservation(update.frame, update.epoch, T_odom_camera, constraint)
            )
        keyframe = self._last_keyframe
        if update.estimate.ok and keyframe is not None and keyframe.world_id == update.epoch:
            self._T_world_odom = update.T_world_camera @ inverse(T_odom_camera)
            T_keyframe_camera = inverse(keyframe.T_world_keyframe) @ T_odom_camera
            self._optimized_trajectory.add(update.frame.stamp_s, keyframe.number, T_keyframe_camera)

    def on_status(self, status: Status) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Optimize the last loops."""
        self.loop_closer.optimize()
        self.snapshot = self.loop_closer.snapshot

    @property
    def has_map(self) -> bool:
        """Whether there is a keyframe."""
        return len(self.loop_closer.database) > 0

    def query(self, frame: RgbdFrame) -> None:
        """Relocalize the frame at once."""
        result = self.loop_closer.relocalize(frame)
        if result is not None:
            self._results.append(result.transform_to(self._T_world_odom))

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """Return the results since the last call."""
        results, self._results = self._results, []
        return results

    def _process_keyframe(self, observation: KeyframeObservation) -> None:
        map_update = self.loop_closer.process_keyframe(observation)
        for removal in map_update.removals:
            self._optimized_trajectory.re_anchor(removal)
        self._last_keyframe = map_update.keyframe
        self.snapshot = self.loop_closer.snapshot
