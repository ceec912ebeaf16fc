"""Loop closure: its parts put together, run on the thread of the caller, and its warm-up."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.files import MEGABYTE
from drivers.core.geometry import Trajectory, inverse
from vo_service.config_tables import MapConfig
from vo_service.kernels.compilation import ensure_compiled
from vo_service.odometry.warm_up import run_warm_up_frames
from vo_service.slam.keyframe_database import KeyframeDatabase, MapKeyframe
from vo_service.slam.keyframe_selection import ConstraintAccumulator, OdometryConstraint
from vo_service.slam.loop_closer import KeyframeObservation, LoopCloser
from vo_service.slam.map_file import MapContents
from vo_service.slam.place_recognizer import PlaceRecognizer
from vo_service.slam.pose_graph import OptimizedTrajectory, PoseGraph
from vo_service.slam.relocalization import RelocalizationResult, RelocalizingOdometry
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import OutputBase


class SynchronousLoopClosure(OutputBase):
    """Output that makes keyframes of the frames, and relocalizer of a `RelocalizingOdometry`.

    The world frame of its keyframes is `odom`, as that of the published poses.
    """

    def __init__(self, loop_closer: LoopCloser) -> None:
        self.loop_closer = loop_closer
        self._T_world_odom = np.eye(4)  # from `odom` to the odometry's world frame
        self._constraints = ConstraintAccumulator()
        self._last_keyframe: MapKeyframe | None = None
        self._results: list[RelocalizationResult] = []
        self._optimized_trajectory = OptimizedTrajectory(loop_closer.graph)
        self.snapshot = loop_closer.snapshot

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of map keyframes and loop closures, by name."""
        closer = self.loop_closer
        return {"map_keyframes": len(closer.database), "loop_closures": closer.loop_count}

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


def create_synchronous_loop_closure(settings: MapConfig) -> SynchronousLoopClosure:
    """Create a loop closure on the caller's thread, with an empty map."""
    return SynchronousLoopClosure(create_loop_closer(settings))


def create_loop_closer(settings: MapConfig) -> LoopCloser:
    """Create a loop closer with an empty map."""
    return LoopCloser(
        PlaceRecognizer(), KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE), PoseGraph()
    )


def create_loop_closer_from_map(contents: MapContents, settings: MapConfig) -> LoopCloser:
    """Create a loop closer with a saved map.

    The map's world frames get negative numbers: new ones are counted from 0.
    """
    saved_ids = sorted({keyframe.world_id for keyframe in contents.keyframes})
    world_ids = {saved_id: rank - len(saved_ids) for rank, saved_id in enumerate(saved_ids)}
    database = KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE)
    for keyframe in contents.keyframes:
        database.add(replace(keyframe, world_id=world_ids[keyframe.world_id]))
    nodes = (replace(node, world_id=world_ids[node.world_id]) for node in contents.nodes)
    graph = PoseGraph(nodes, contents.edges)
    return LoopCloser(PlaceRecognizer(), database, graph, contents.next_number)


def warm_up_loop_closure(report_stage: Callable[[str], None]) -> None:
    """Compile the kernels of loop closure, or load them, by running it on generated frames.

    Args:
        report_stage: Called with the name of the stage, and with the progress of compilation.
    """
    ensure_compiled(["loop closure"], report_stage)
    report_stage("place recognition")
    run_warm_up_frames(StationaryOdometry)


class StationaryOdometry:
    """Odometry at rest; each frame is a keyframe in a world frame of its own."""

    def __init__(self) -> None:
        self._loop_closer = create_loop_closer(MapConfig())

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Make a keyframe of the frame, and recognize it."""
        constraint = OdometryConstraint(np.zeros(6), np.eye(6), 0.0)
        self._loop_closer.process_keyframe(
            KeyframeObservation(frame, frame.seq, np.eye(4), constraint)
        )
        self._loop_closer.relocalize(frame)
        return Estimate(True, "", np.eye(4), np.eye(4), np.zeros((6, 6)))
