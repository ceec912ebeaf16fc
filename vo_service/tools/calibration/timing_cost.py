"""Cost of a sensor's timing on a segment of frames.

The direct odometry gives the camera's pose and velocity at each stamp, which depend little on the
timing. The photometric residuals between images depend on it strongly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.timing_residuals import (
    PosedFrame,
    brightness_sigmas,
    make_posed_frame,
)

# A velocity is the derivative of a polynomial through this many poses on either side.
NEIGHBORS = 2
# Every n-th frame is a reference; this many frames before and after are aligned with it.
REFERENCE_STRIDE, REFERENCE_REACH = 8, 6
# Minimum number of alignments in a segment.
MIN_ALIGNMENTS = 12


@dataclass(frozen=True)
class SensorTiming:
    """Timing of a sensor.

    Attributes:
        readout_s: Time from the first row to the last, of both images.
        depth_offset_s: True time of a depth image minus its stamp, relative to color.
    """

    readout_s: float
    depth_offset_s: float


def timing_costs(
    frames: Sequence[RgbdFrame], assumed: SensorTiming, candidates: Sequence[SensorTiming]
) -> Array:
    """Return the mean log standard deviation (N,) of brightness residuals for each timing.

    Args:
        frames: Frames of a segment; their skew is the difference of their stamps.
        assumed: Timing for the tracking of the camera.
        candidates: N timings.

    Returns:
        (N,) costs; NaN if the camera cannot be tracked.
    """
    posed_frames = track_motion(frames, assumed)
    sigmas = [_brightness_sigmas(posed_frames, timing) for timing in candidates]
    if min(map(len, sigmas)) < MIN_ALIGNMENTS:
        return np.full(len(candidates), np.nan)
    means: Array = np.log(sigmas).mean(axis=1)
    return means


def track_motion(frames: Sequence[RgbdFrame], timing: SensorTiming) -> dict[int, PosedFrame]:
    """Return pose and velocity by the frame's index in the segment, without lost frames."""
    odometry = DirectOdometry()
    poses: dict[int, Array] = {}
    for n, frame in enumerate(frames):
        estimate = odometry.estimate(
            replace(
                frame,
                readout_s=timing.readout_s,
                skew_s=frame.skew_s + timing.depth_offset_s,
            )
        )
        if estimate.is_reset:
            poses.clear()
        if estimate.ok:
            poses[n] = estimate.T_world_camera
    posed_frames = {}
    for n in poses:
        neighbors = range(n - NEIGHBORS, n + NEIGHBORS + 1)
        if all(m in poses for m in neighbors):
            stamps_s = np.array([frames[m].stamp_s for m in neighbors])
            velocity = fit_velocity([poses[m] for m in neighbors], stamps_s)
            posed_frames[n] = make_posed_frame(frames[n], poses[n], velocity)
    return posed_frames


def fit_velocity(T_world_camera: Sequence[Array], stamps_s: Array) -> Array:
    """Return the twist (6,) of the camera in its own frame at the middle of an odd number of poses.

    It is the derivative of the polynomial through the twists relative to the middle pose.
    """
    middle = len(stamps_s) // 2
    T_middle_world = inverse(T_world_camera[middle])
    twists = np.array([se3_log(T_middle_world @ T) for T in T_world_camera])
    powers = np.vander(stamps_s - stamps_s[middle], increasing=True)
    slopes: Array = np.linalg.solve(powers, twists)[1]
    return slopes


def _brightness_sigmas(posed_frames: dict[int, PosedFrame], timing: SensorTiming) -> list[float]:
    timed_frames = {
        n: m.with_timing(timing.readout_s, timing.depth_offset_s) for n, m in posed_frames.items()
    }
    sigmas: list[float] = []
    for n in range(
        NEIGHBORS + REFERENCE_STRIDE // 2, max(timed_frames, default=0) + 1, REFERENCE_STRIDE
    ):
        if n in timed_frames:
            others = [
                timed_frames[m]
                for m in range(n - REFERENCE_REACH, n + REFERENCE_REACH + 1)
                if m != n and m in timed_frames
            ]
            sigmas += brightness_sigmas(timed_frames[n], others)
    return sigmas
