"""From results to what the viewer's process is told of them."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.geometry import inverse
from drivers.trajectory import StampedPoses
from vo_service.types import PoseUpdate, Status, TruthSource, no_truth
from vo_service.viewer.map_sketch import MapSketch
from vo_service.viewer.messages import (
    Backdrop,
    Graph,
    Message,
    Numbers,
    Picture,
    Point,
    State,
    Truth,
)
from vo_service.viewer.sinks import Sink
from vo_service.viewer.throttle import Throttle

TRUTH_WITHIN_S = 0.02


class Sketcher:
    """Numbers for every result, pictures for some; remembers what a new process has to be told."""

    def __init__(self, sink: Sink, picture_period_s: float, truth: TruthSource) -> None:
        self._clock_s = sink.clock_s
        self._throttle = Throttle(picture_period_s)
        self._truth = truth
        self._map = MapSketch()
        self.backdrop = Backdrop()

    def of_pose(self, update: PoseUpdate) -> Iterator[Message]:
        """What to say of one result."""
        estimate = update.estimate
        yield Numbers(
            seq=update.seq,
            stamp_s=update.stamp_s,
            T_world_camera=update.T_world_camera,
            counts={
                "features": estimate.features,
                "matches": estimate.matches,
                "inliers": estimate.inliers,
            },
            stage_ms=update.stage_ms,
            state=State(update.state, update.reason, update.epoch),
        )
        yield from self._new_truth(update)
        now_s = self._clock_s(update.frame.stamp_s)
        self._map.see(update)
        yield from self._told(self._map.of_time(now_s))
        if self._throttle.due(now_s):
            yield from self._new_point(update)
            yield from self._map.corrected(update)
            # A copy of the frame leaves behind what others have derived from it.
            yield Picture(replace(update.frame), estimate.evidence)

    def of_status(self, status: Status) -> State:
        """What to say of a status: a change of state may come without a frame."""
        return State(status.state, status.reason, status.epoch)

    def rest(self) -> Iterator[Message]:
        """What was not said yet, when nothing follows."""
        yield from self._told(self._map.rest())

    def _told(self, graphs: Iterator[Graph]) -> Iterator[Graph]:
        for graph in graphs:
            self.backdrop = replace(self.backdrop, graph=graph)
            yield graph

    def _new_point(self, update: PoseUpdate) -> Iterator[Message]:
        position = update.T_world_camera[:3, 3]
        if update.estimate.ok and self.backdrop.trail.add(position, update.epoch):
            yield Point(position, update.epoch)

    def _new_truth(self, update: PoseUpdate) -> Iterator[Message]:
        """Once, as soon as a frame has truth."""
        truth = self._truth()
        if truth is None or not update.estimate.ok:
            return
        found = _aligned(truth, update)
        if found is not None:
            self._truth = no_truth
            self.backdrop = replace(self.backdrop, truth=found)
            yield found


def _aligned(truth: StampedPoses, update: PoseUpdate) -> Truth | None:
    """The truth, moved so that its pose at this frame is the estimate's: what grows apart is drift.

    None if it has no pose at this time.
    """
    gaps_s = np.abs(truth.stamps_s - update.frame.stamp_s)
    nearest = int(np.argmin(gaps_s))
    if gaps_s[nearest] > TRUTH_WITHIN_S:
        return None
    T_world_truth = update.T_world_camera @ inverse(truth.T_world_camera[nearest])
    return Truth((T_world_truth @ truth.T_world_camera)[:, :3, 3])
