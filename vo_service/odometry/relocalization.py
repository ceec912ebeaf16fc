"""After a loss, a new beginning counts only where no place is known again.

An odometry that has lost its way begins anew: it then knows how it moves, but not where it is. As
long as there is hope that a place is known again, its pose counts as lost; after that, it is where
the old pose was held, in a new epoch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, orthonormalize, poses_close
from vo_service.types import Estimate, Odometry

# So many frames with a motion are looked at before hope is given up: a second.
MAX_SEARCH_FRAMES = 30
# Of these, every so manieth is shown to the finder.
QUERY_INTERVAL_FRAMES = 3
# No camera goes faster, and a little more: an answer that is further from the last good pose is of
# another place that looks the same.
MAX_SPEED_M_S, POSITION_MARGIN_M = 1.5, 0.5
# Two answers agree if they put the camera at the same place to within this.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD = 0.05, 0.035


@dataclass(frozen=True)
class RelocalizationResult:
    """Where a frame was taken.

    seq             of the frame
    T_world_camera  4x4, in the world that the poses before the loss were in
    covariance      6x6 of it: (translation m, rotation rad), as a small motion in the camera's axes
    """

    seq: int
    T_world_camera: Array
    covariance: Array

    def transform_to(self, T_other_world: Array) -> "RelocalizationResult":
        """The same in another world; 4x4 from this one to that."""
        return replace(self, T_world_camera=T_other_world @ self.T_world_camera)


class Relocalizer(Protocol):
    """Knows the places that the camera has seen. None of its methods blocks for long."""

    @property
    def has_map(self) -> bool:
        """Whether there is any hope."""
        ...

    def query(self, frame: RgbdFrame) -> None:
        """Ask where this frame was taken."""
        ...

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """What has been found since the last call; frames that show no known place are not in."""
        ...


@dataclass
class _RelocalizationSearch:
    """What is known since tracking began anew.

    T_world_last  4x4, the last good pose
    frames_left   of the patience
    asked         of each frame that was asked about, by its number: 4x4 pose in the odometry's new
                  world, and how far it can be from the last good one, metres
    found         (4x4 T_world_inner, covariance) that each answer leads to
    """

    T_world_last: Array
    frames_left: int = MAX_SEARCH_FRAMES
    queries: dict[int, tuple[Array, float]] = field(default_factory=dict)
    candidates: list[tuple[Array, Array]] = field(default_factory=list)

    def add_result(self, result: RelocalizationResult) -> tuple[Array, Array] | None:
        """The link between the worlds, once two answers agree about it."""
        T_inner_camera, farthest_m = self.queries.pop(result.seq, (np.eye(4), -1.0))
        way_m = np.linalg.norm(result.T_world_camera[:3, 3] - self.T_world_last[:3, 3])
        if way_m > farthest_m:  # also: asked before tracking began anew once more
            return None
        link = orthonormalize(result.T_world_camera @ inverse(T_inner_camera))
        is_agreed = any(
            poses_close(link, other, MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD)
            for other, _ in self.candidates
        )
        self.candidates.append((link, result.covariance))
        return self.candidates[-1] if is_agreed else None


class RelocalizingOdometry:
    """Another odometry, which comes back to its world where it sees a place of it again."""

    def __init__(self, odometry: Odometry, relocalizer: Relocalizer) -> None:
        self._odometry = odometry
        self._relocalizer = relocalizer
        self._search: _RelocalizationSearch | None = None
        self._T_world_inner = np.eye(4)
        self._T_world_camera, self._stamp_s = np.eye(4), 0.0  # the last good pose
        self._T_world_reference = np.eye(4)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """As `Odometry`; after a loss not ok until it is known where the camera is."""
        estimate = self._odometry.estimate(frame)
        if estimate.is_reset and (self._search is not None or self._relocalizer.has_map):
            # Where it was begun anew before, the patience goes on, not the answers.
            left = MAX_SEARCH_FRAMES if self._search is None else self._search.frames_left
            self._search = _RelocalizationSearch(self._T_world_camera, left)
        if self._search is None:
            return self._to_world(frame, estimate)
        return self._continue_search(frame, estimate, self._search)

    def _continue_search(
        self, frame: RgbdFrame, estimate: Estimate, search: _RelocalizationSearch
    ) -> Estimate:
        """Ask, listen, and come back, or give up."""
        if not estimate.ok:
            return self._report_lost(estimate, estimate.reason)
        if search.frames_left % QUERY_INTERVAL_FRAMES == 0:
            farthest_m = POSITION_MARGIN_M + MAX_SPEED_M_S * (frame.stamp_s - self._stamp_s)
            search.queries[frame.seq] = estimate.T_world_camera, farthest_m
            self._relocalizer.query(frame)
        for located in self._relocalizer.poll_results():
            link = search.add_result(located)
            if link is not None:
                self._search = None
                self._T_world_inner, covariance = link
                back = replace(estimate, is_reset=False, covariance=covariance)
                return self._to_world(frame, back)
        search.frames_left -= 1
        if search.frames_left <= 0:
            self._search = None
            return self._to_world(frame, replace(estimate, is_reset=True))
        return self._report_lost(estimate, "looking for a place that was seen before")

    def _report_lost(self, estimate: Estimate, reason: str) -> Estimate:
        """No pose for now: the last good one is held."""
        held = self._T_world_camera.copy()
        zeros = np.zeros((6, 6))
        return replace(
            estimate, ok=False, reason=reason, is_reset=False,
            T_world_camera=held, T_reference_camera=np.eye(4), covariance=zeros,
        )  # fmt: skip

    def _to_world(self, frame: RgbdFrame, estimate: Estimate) -> Estimate:
        """The same, in the world of the first frame, and counted from what was told before."""
        T_world_camera = self._T_world_inner @ estimate.T_world_camera
        T_reference_camera = inverse(self._T_world_reference) @ T_world_camera
        if estimate.ok:
            self._T_world_camera, self._stamp_s = T_world_camera, frame.stamp_s
            if estimate.is_next_reference:
                self._T_world_reference = T_world_camera
        return replace(
            estimate, T_world_camera=T_world_camera, T_reference_camera=T_reference_camera
        )
