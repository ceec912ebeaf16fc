"""Messages for the viewer, made from updates: downscaled images, features and the map."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Trajectory, inverse, transform_points
from drivers.core.rate_limits import Throttle
from drivers.ros_messages.sensors import LaserScanMessage
from vo_service.outputs.rerun.messages import (
    CorrectedPosition,
    FrameImages,
    FrameScalars,
    GridCells,
    GroundTruth,
    InitialState,
    MapGraph,
    RerunMessage,
    ScanPoints,
    TrackingStatus,
    TrajectoryPoint,
)
from vo_service.outputs.rerun.sinks import Sink
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.messages import Status
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import GroundTruthSource, no_ground_truth

# A map of hours has tens of thousands of numbers, so it is sent at most this often.
MIN_MAP_PERIOD_S = 1.0


class MapEncoder:
    """Places the map in the world of the first camera, where the odometry's poses are drawn.

    The transform from map to world stays fixed while the map is corrected. Corrected keyframes thus
    move onto the ground truth and away from the odometry's trajectory. Until the camera is
    localized, the transform follows the camera's pose.

    Attributes:
        graph: The map in the world; another object when it changes.
        T_world_map: 4x4; another object when it changes.
    """

    def __init__(self) -> None:
        self._map: MapSnapshot = NO_MAP
        self.T_world_map = np.eye(4)
        self._is_anchored = False
        self.graph = MapGraph()

    def update(self, update: OdometryUpdate) -> None:
        """Take over the map of one result."""
        if update.map is self._map or not update.estimate.ok:
            return
        self._map = update.map
        if not self._is_anchored:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            self.T_world_map = update.T_world_camera @ inverse(T_map_camera)
            self._is_anchored = update.is_localized
        self.graph = self._build_graph()

    def place_grid(self, grid: OccupancyGrid) -> GridCells:
        """Place the cells of the occupancy grid in the world."""
        occupied, free = (
            transform_points(self.T_world_map, grid.centers_m(value)).astype(np.float32)
            for value in (OCCUPIED, FREE)
        )
        return GridCells(occupied, free, grid.resolution_m)

    def encode_corrected_position(self, update: OdometryUpdate) -> Iterator[CorrectedPosition]:
        """Yield the camera's position in the map, if the map is of the same epoch."""
        if self._map is not NO_MAP and self._map.epoch == update.epoch:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            yield CorrectedPosition((self.T_world_map @ T_map_camera)[:3, 3])

    def _build_graph(self) -> MapGraph:
        snapshot = self._map
        in_world = transform_points(self.T_world_map, snapshot.T_map_keyframe[:, :3, 3])
        positions: NDArray[np.float32] = in_world.astype(np.float32)
        lines = positions[snapshot.edges]
        is_loop = snapshot.is_loop_closure
        return MapGraph(positions, lines[~is_loop], lines[is_loop])


class UpdateEncoder:
    """Encodes scalars for every result and images for some.

    Attributes:
        initial_state: Everything drawn so far, for a new process.
    """

    def __init__(
        self,
        sink: Sink,
        image_period_s: float,
        ground_truth: GroundTruthSource,
    ) -> None:
        self._rate_clock_s = sink.rate_clock_s
        self._throttle, self._map_throttle = Throttle(image_period_s), Throttle(MIN_MAP_PERIOD_S)
        self._ground_truth = ground_truth
        self._map = MapEncoder()
        self._grid, self._T_world_grid = NO_GRID, self._map.T_world_map
        self.initial_state = InitialState(graph=self._map.graph)

    def encode_update(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        """Yield the messages of one result."""
        estimate = update.estimate
        yield FrameScalars(
            seq=update.seq,
            stamp_s=update.stamp_s,
            T_world_camera=update.T_world_camera,
            counts={
                "features": estimate.features,
                "matches": estimate.matches,
                "inliers": estimate.inliers,
            },
            stage_ms=update.stage_ms,
            state=TrackingStatus(update.state, update.reason, update.epoch),
            timing=estimate.timing,
        )
        yield from self._encode_ground_truth(update)
        now_s = self._rate_clock_s(update.frame.stamp_s)
        self._map.update(update)
        if self._is_map_pending and self._map_throttle.allow(now_s):
            yield from self.encode_pending()
        if self._throttle.allow(now_s):
            yield from self._encode_point(update)
            yield from self._map.encode_corrected_position(update)
            # A copy of the frame omits the cached values derived from it.
            yield FrameImages(replace(update.frame), estimate.debug)
            yield from self._encode_navigation(update)

    def _encode_navigation(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        """Yield the scan, and the occupancy grid if it or its place in the world has changed."""
        scan = update.scan.message() if update.scan.is_above_floor else None
        if scan is not None:
            yield _place_scan(scan, update)
        if update.grid is not self._grid or self._map.T_world_map is not self._T_world_grid:
            self._grid, self._T_world_grid = update.grid, self._map.T_world_map
            cells = self._map.place_grid(update.grid)
            self.initial_state = replace(self.initial_state, grid=cells)
            yield cells

    def encode_status(self, status: Status) -> TrackingStatus:
        """Encode a status: the state may change without a frame."""
        return TrackingStatus(status.state, status.reason, status.epoch)

    @property
    def _is_map_pending(self) -> bool:
        """Whether the map has changed since it was sent."""
        return self._map.graph is not self.initial_state.graph

    def encode_pending(self) -> Iterator[MapGraph]:
        """Yield the map if it has changed since it was sent."""
        if self._is_map_pending:
            self.initial_state = replace(self.initial_state, graph=self._map.graph)
            yield self._map.graph

    def _encode_point(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        position = update.T_world_camera[:3, 3]
        if update.estimate.ok and self.initial_state.trajectory.add(position, update.epoch):
            yield TrajectoryPoint(position, update.epoch)

    def _encode_ground_truth(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        """Yield the ground truth once, at the first frame that has it."""
        trajectory = self._ground_truth()
        if trajectory is None or not update.estimate.ok:
            return
        ground_truth = _align_ground_truth(trajectory, update)
        if ground_truth is not None:
            self._ground_truth = no_ground_truth
            self.initial_state = replace(self.initial_state, ground_truth=ground_truth)
            yield ground_truth


def _place_scan(scan: LaserScanMessage, update: OdometryUpdate) -> ScanPoints:
    """Place the ends of the scan's ranges in the world."""
    is_hit = np.isfinite(scan.ranges_m)
    ranges, angles = scan.ranges_m[is_hit], scan.angles_rad[is_hit]
    ends = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges], axis=1)
    T_world_odom = update.T_world_camera @ inverse(update.T_odom_camera)
    T_world_scan = T_world_odom @ update.T_odom_base @ update.scan.T_base_scan
    return ScanPoints(transform_points(T_world_scan, ends).astype(np.float32))


def _align_ground_truth(ground_truth: Trajectory, update: OdometryUpdate) -> GroundTruth | None:
    """Align the ground truth with the estimate at this frame, so that later gaps show drift.

    Returns None if the ground truth has no pose at this time.
    """
    T_truth_camera = ground_truth.pose_near(update.frame.stamp_s)
    if T_truth_camera is None:
        return None
    T_world_truth = update.T_world_camera @ inverse(T_truth_camera)
    return GroundTruth((T_world_truth @ ground_truth.T_world_camera)[:, :3, 3])
