"""Relocalization: after a loss the pose is recovered from the map, if possible.

A lost odometry resets: it tracks the motion again, but its pose in the world is unknown. During the
search the pose counts as lost. Without success a new epoch starts at the last pose.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, orthonormalize, poses_close
from vo_service.types.estimate import Estimate
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.odometry import Odometry
from vo_service.types.odometry_update import OdometryUpdate

# The search ends after this many tracked frames: a second.
MAX_SEARCH_FRAMES = 30
# Every 3rd frame is sent to the relocalizer.
QUERY_INTERVAL_FRAMES = 3
# A result further from the last good pose than this speed and margin allow is of a similar place.
MAX_SPEED_M_S, POSITION_MARGIN_M = 1.5, 0.5
# Two results agree if their poses differ by no more than this.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD = 0.05, 0.035


@dataclass(frozen=True)
class RelocalizationResult:
    """Pose of a frame by the map.

    Attributes:
        seq: Sequence number of the frame.
        T_world_camera: 4x4 pose, in the world frame of the poses before the loss.
        covariance: 6x6: (translation m, rotation rad), as a small motion in the camera's axes.
    """

    seq: int
    T_world_camera: Array
    covariance: Array

    def transform_to(self, T_other_world: Array) -> "RelocalizationResult":
        """Transform the result to another world frame by T_other_world (4x4)."""
        return replace(self, T_world_camera=T_other_world @ self.T_world_camera)


class Relocalizer(Protocol):
    """Finds the pose of a frame by a map of keyframes. Its methods do not block."""

    @property
    def has_map(self) -> bool:
        """Whether there is a map to search."""
        ...

    def query(self, frame: RgbdFrame) -> None:
        """Request the pose of a frame."""
        ...

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """Results since the last call; unrecognized frames give none."""
        ...


@dataclass
class _RelocalizationSearch:
    """State of the search since the odometry was reset.

    Attributes:
        T_world_last: 4x4, the last good pose.
        frames_left: Until the search ends.
        queries: By the sequence number of each queried frame: its 4x4 pose in the odometry's new
            world frame, and its largest distance from the last good pose, m.
        candidates: (4x4 T_world_inner, covariance) by each result.
    """

    T_world_last: Array
    frames_left: int = MAX_SEARCH_FRAMES
    queries: dict[int, tuple[Array, float]] = field(default_factory=dict)
    candidates: list[tuple[Array, Array]] = field(default_factory=list)

    def add_result(self, result: RelocalizationResult) -> tuple[Array, Array] | None:
        """Add a result; return T_world_inner and its covariance once two results agree."""
        T_inner_camera, max_distance_m = self.queries.pop(result.seq, (np.eye(4), -1.0))
        distance_m = np.linalg.norm(result.T_world_camera[:3, 3] - self.T_world_last[:3, 3])
        if distance_m > max_distance_m:  # also if the query is of an earlier search
            return None
        T_world_inner = orthonormalize(result.T_world_camera @ inverse(T_inner_camera))
        is_agreed = any(
            poses_close(T_world_inner, other, MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD)
            for other, _ in self.candidates
        )
        self.candidates.append((T_world_inner, result.covariance))
        return self.candidates[-1] if is_agreed else None


class RelocalizingOdometry:
    """Wrapper of an odometry that relocalizes it after a loss.

    Args:
        odometry: The odometry to wrap.
        relocalizer: Finds poses in the map.
    """

    def __init__(self, odometry: Odometry, relocalizer: Relocalizer) -> None:
        self._odometry = odometry
        self._relocalizer = relocalizer
        self._search: _RelocalizationSearch | None = None
        self._T_world_inner = np.eye(4)
        self._T_world_camera, self._stamp_s = np.eye(4), 0.0  # the last good pose
        self._T_world_reference = np.eye(4)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose as `Odometry`; after a loss not ok until the search has ended."""
        estimate = self._odometry.estimate(frame)
        if estimate.is_reset and (self._search is not None or self._relocalizer.has_map):
            # A reset during a search keeps its remaining time, but drops its results.
            frames_left = MAX_SEARCH_FRAMES if self._search is None else self._search.frames_left
            self._search = _RelocalizationSearch(self._T_world_camera, frames_left)
        if self._search is None:
            return self._to_world(frame, estimate)
        return self._continue_search(frame, estimate, self._search)

    def _continue_search(
        self, frame: RgbdFrame, estimate: Estimate, search: _RelocalizationSearch
    ) -> Estimate:
        """Send queries and take results; relocalize, or end the search."""
        if not estimate.ok:
            return self._report_lost(estimate, estimate.reason)
        if search.frames_left % QUERY_INTERVAL_FRAMES == 0:
            max_distance_m = POSITION_MARGIN_M + MAX_SPEED_M_S * (frame.stamp_s - self._stamp_s)
            search.queries[frame.seq] = estimate.T_world_camera, max_distance_m
            self._relocalizer.query(frame)
        for result in self._relocalizer.poll_results():
            agreed = search.add_result(result)
            if agreed is not None:
                self._search = None
                self._T_world_inner, covariance = agreed
                relocalized = replace(estimate, is_reset=False, covariance=covariance)
                return self._to_world(frame, relocalized)
        search.frames_left -= 1
        if search.frames_left <= 0:
            self._search = None
            return self._to_world(frame, replace(estimate, is_reset=True))
        return self._report_lost(estimate, "relocalizing")

    def _report_lost(self, estimate: Estimate, reason: str) -> Estimate:
        """Return an estimate without success, at the last good pose."""
        return replace(
            estimate,
            ok=False,
            reason=reason,
            is_reset=False,
            T_world_camera=self._T_world_camera.copy(),
            T_reference_camera=np.eye(4),
            covariance=np.zeros((6, 6)),
        )

    def _to_world(self, frame: RgbdFrame, estimate: Estimate) -> Estimate:
        """Transform an estimate to the world frame, and to the last reference in it."""
        T_world_camera = self._T_world_inner @ estimate.T_world_camera
        T_reference_camera = inverse(self._T_world_reference) @ T_world_camera
        if estimate.ok:
            self._T_world_camera, self._stamp_s = T_world_camera, frame.stamp_s
            if estimate.is_next_reference:
                self._T_world_reference = T_world_camera
        return replace(
            estimate, T_world_camera=T_world_camera, T_reference_camera=T_reference_camera
        )


# Largest number of results that are not polled.
_MAX_PENDING_RESULTS = 10


class AsynchronousLoopClosure:
    """Relocalizer of a `RelocalizingOdometry`, with the last snapshot of the map.

    `handle_message` and `reset` are called on another thread than the rest.

    Args:
        submit: Sends a frame to the process, as a query.
    """

    def __init__(self, submit: Callable[[OdometryUpdate], None]) -> None:
        self._submit = submit
        self._last_good: OdometryUpdate | None = None
        self._last_update: OdometryUpdate | None = None
        self._results: deque[RelocalizationResult] = deque(maxlen=_MAX_PENDING_RESULTS)
        self.snapshot: MapSnapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """Wrap the odometry so that it relocalizes after a loss."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Keep the update, for the transform between the odometry's world frame and `odom`."""
        self._last_update = update
        if update.estimate.ok:
            self._last_good = update

    @property
    def has_map(self) -> bool:
        """Whether the map has a keyframe."""
        return self.snapshot.keyframes > 0

    def query(self, frame: RgbdFrame) -> None:
        """Send the frame to the process as a query."""
        if self._last_update is not None:
            epoch = 0 if self._last_good is None else self._last_good.epoch
            self._submit(replace(self._last_update, frame=frame, epoch=epoch))

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """Return the results since the last call."""
        results = []
        while self._results:
            results.append(self._results.popleft().transform_to(self._T_world_odom()))
        return results

    def _T_world_odom(self) -> Array:
        """4x4 transform from `odom` to the odometry's world frame."""
        last = self._last_good
        return np.eye(4) if last is None else last.T_world_camera @ inverse(last.T_odom_camera)

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """Handle a message of the process."""
        if isinstance(message, RelocalizationResult):
            self._results.append(message)
        else:
            self.snapshot = message

    def reset(self) -> None:
        """Drop the map after the process has lost it."""
        self.snapshot = NO_MAP
