"""What every odometry answers: a pose, how sure it is, or why there is none."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array


def _empty_pixels() -> NDArray[np.float32]:
    return np.empty((0, 2), np.float32)


@dataclass(frozen=True)
class TrackingDebug:
    """What a viewer can draw of one estimate. Pixels are (u, v) in the color image.

    keypoints_px          (N, 2) features of this frame
    matches_px            (M, 2) matched features of this frame
    reference_matches_px  (M, 2) the same features where the frame that it was matched with had
                          them: the last good one, or an older one where tracking was lost
    inlier                (M,) bool, True where the match agrees with the motion found
    """

    keypoints_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    reference_matches_px: NDArray[np.float32] = field(default_factory=_empty_pixels)
    inlier: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))


@dataclass(frozen=True)
class Estimate:
    """Result of one frame.

    ok                     False: no motion could be found; `reason` says why
    reason                 one short clause for people. With ok: what the motion had to do without,
                           "" where nothing was amiss
    T_world_camera         4x4 pose; world is the first camera. Not ok: the last good pose
    T_reference_camera     4x4 motion since the reference: the last good frame, unless that said
                           that it is not the next reference
    covariance             6x6 of T_reference_camera: (translation m, rotation rad), as a small
                           motion in this camera's own axes; zero for the first frame. Found by an
                           older frame: of the way back to that one and on to this one
    inliers                matches that agree with the motion
    matches, features      how many matches and features there were
    restarted              True when the pose is not continuous with the one before
    is_next_reference      True where the next motion is counted from this frame on; else it is
                           counted from the reference of this one, and so is its covariance
    evidence               what a viewer can draw
    """

    ok: bool
    reason: str
    T_world_camera: Array
    T_reference_camera: Array
    covariance: Array
    features: int = 0
    matches: int = 0
    inliers: int = 0
    is_reset: bool = False
    is_next_reference: bool = True
    debug: TrackingDebug = field(default_factory=TrackingDebug)


class Odometry(Protocol):
    """An estimator of the camera's motion. Siblings share this one method."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is at this frame. Never raises for what the camera sees."""
        ...
