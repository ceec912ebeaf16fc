"""From results to what the viewer's process is told of them."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.core.geometry import inverse
from drivers.core.rate_limit import Throttle
from drivers.core.trajectory import Trajectory
from vo_service.outputs.rerun.map_encoder import MapEncoder
from vo_service.outputs.rerun.messages import (
    FrameImages,
    FrameScalars,
    GroundTruth,
    InitialState,
    MapGraph,
    RerunMessage,
    TrackingStatus,
    TrajectoryPoint,
)
from vo_service.outputs.rerun.sinks import Sink
from vo_service.types import GroundTruthSource, OdometryUpdate, Status, no_ground_truth

MAX_GROUND_TRUTH_GAP_S = 0.02


class UpdateEncoder:
    """Numbers for every result, pictures for some; remembers what a new process has to be told."""

    def __init__(self, sink: Sink, image_period_s: float, ground_truth: GroundTruthSource) -> None:
        self._rate_clock_s = sink.rate_clock_s
        self._throttle = Throttle(image_period_s)
        self._ground_truth = ground_truth
        self._map = MapEncoder()
        self.initial_state = InitialState()

    def encode_update(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        """What to say of one result."""
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
        )
        yield from self._encode_ground_truth(update)
        now_s = self._rate_clock_s(update.frame.stamp_s)
        self._map.update(update)
        yield from self._remember_graphs(self._map.encode_if_due(now_s))
        if self._throttle.allow(now_s):
            yield from self._encode_point(update)
            yield from self._map.encode_corrected_position(update)
            # A copy of the frame leaves behind what others have derived from it.
            yield FrameImages(replace(update.frame), estimate.debug)

    def encode_status(self, status: Status) -> TrackingStatus:
        """What to say of a status: a change of state may come without a frame."""
        return TrackingStatus(status.state, status.reason, status.epoch)

    def encode_pending(self) -> Iterator[RerunMessage]:
        """What was not said yet, when nothing follows."""
        yield from self._remember_graphs(self._map.encode_pending())

    def _remember_graphs(self, graphs: Iterator[MapGraph]) -> Iterator[MapGraph]:
        for graph in graphs:
            self.initial_state = replace(self.initial_state, graph=graph)
            yield graph

    def _encode_point(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        position = update.T_world_camera[:3, 3]
        if update.estimate.ok and self.initial_state.trajectory.add(position, update.epoch):
            yield TrajectoryPoint(position, update.epoch)

    def _encode_ground_truth(self, update: OdometryUpdate) -> Iterator[RerunMessage]:
        """Once, as soon as a frame has truth."""
        truth = self._ground_truth()
        if truth is None or not update.estimate.ok:
            return
        found = _align_ground_truth(truth, update)
        if found is not None:
            self._ground_truth = no_ground_truth
            self.initial_state = replace(self.initial_state, ground_truth=found)
            yield found


def _align_ground_truth(ground_truth: Trajectory, update: OdometryUpdate) -> GroundTruth | None:
    """The truth, moved so that its pose at this frame is the estimate's: what grows apart is drift.

    None if it has no pose at this time.
    """
    gaps_s = np.abs(ground_truth.stamps_s - update.frame.stamp_s)
    nearest = int(np.argmin(gaps_s))
    if gaps_s[nearest] > MAX_GROUND_TRUTH_GAP_S:
        return None
    T_world_truth = update.T_world_camera @ inverse(ground_truth.T_world_camera[nearest])
    return GroundTruth((T_world_truth @ ground_truth.T_world_camera)[:, :3, 3])
