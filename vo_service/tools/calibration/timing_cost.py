"""How badly a sensor's timing explains a piece of film.

The keyframe odometry says where the camera was at each stamp, and so how fast it moved there. That
depends little on the timing. How well images then fit one another, row by row, depends on it much.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.se3 import se3_log
from vo_service.odometry.direct.timing_residuals import (
    PosedFrame,
    brightness_sigmas,
    make_posed_frame,
)

# A velocity is that of a curve through so many poses on either side.
NEIGHBORS = 2
# Every so often a frame is one that others are laid on: so many before and after it.
REFERENCE_STRIDE, REFERENCE_REACH = 8, 6
# Fewer frames that are laid on others say too little of a piece.
MIN_ALIGNMENTS = 12


@dataclass(frozen=True)
class SensorTiming:
    """When rows are taken.

    readout_s       from the first row to the last, of both images
    depth_offset_s  instant of a depth image minus what its stamp says, relative to color
    """

    readout_s: float
    depth_offset_s: float


def timing_costs(
    frames: Sequence[RgbdFrame], assumed: SensorTiming, candidates: Sequence[SensorTiming]
) -> Array:
    """(N,) mean logarithm of the brightness' spread, for each of the timings.

    piece  frames whose skew is the difference of their stamps
    known  what the timing is thought to be, to follow the camera with

    NaN where the camera cannot be followed.
    """
    moments = track_motion(frames, assumed)
    spreads = [_brightness_spreads(moments, timing) for timing in candidates]
    if min(map(len, spreads)) < MIN_ALIGNMENTS:
        return np.full(len(candidates), np.nan)
    means: Array = np.log(spreads).mean(axis=1)
    return means


def track_motion(frames: Sequence[RgbdFrame], timing: SensorTiming) -> dict[int, PosedFrame]:
    """Where the camera was and how fast, by the frame's place in the piece; not where lost."""
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
    moments = {}
    for n in poses:
        around = range(n - NEIGHBORS, n + NEIGHBORS + 1)
        if all(m in poses for m in around):
            stamps_s = np.array([frames[m].stamp_s for m in around])
            velocity = fit_velocity([poses[m] for m in around], stamps_s)
            moments[n] = make_posed_frame(frames[n], poses[n], velocity)
    return moments


def fit_velocity(T_world_camera: Sequence[Array], stamps_s: Array) -> Array:
    """(6,) twist of the camera in its own axes at the middle of an odd number of poses.

    It is the slope of the polynomial through their twists as seen from the middle one.
    """
    middle = len(stamps_s) // 2
    T_middle_world = inverse(T_world_camera[middle])
    twists = np.array([se3_log(T_middle_world @ T) for T in T_world_camera])
    powers = np.vander(stamps_s - stamps_s[middle], increasing=True)
    slopes: Array = np.linalg.solve(powers, twists)[1]
    return slopes


def _brightness_spreads(moments: dict[int, PosedFrame], timing: SensorTiming) -> list[float]:
    timed = {n: m.with_timing(timing.readout_s, timing.depth_offset_s) for n, m in moments.items()}
    spreads: list[float] = []
    for n in range(NEIGHBORS + REFERENCE_STRIDE // 2, max(timed, default=0) + 1, REFERENCE_STRIDE):
        if n in timed:
            near = [
                timed[m]
                for m in range(n - REFERENCE_REACH, n + REFERENCE_REACH + 1)
                if m != n and m in timed
            ]
            spreads += brightness_sigmas(timed[n], near)
    return spreads
