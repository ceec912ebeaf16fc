"""Warm-up of the loop closure: compile its kernels, or load them from the cache."""

import time
from collections.abc import Callable

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.config_tables import MapConfig
from vo_service.odometry.registry import run_warm_up_frames
from vo_service.slam.loop_closure.factory import create_loop_closer
from vo_service.slam.loop_closure.loop_closer import KeyframeObservation
from vo_service.slam.loop_closure.odometry_constraint import OdometryConstraint
from vo_service.types import Estimate


def warm_up_loop_closure(report_stage: Callable[[str], None]) -> float:
    """Run the loop closure on generated frames.

    Args:
        report_stage: Called with the name of the only stage when it starts.

    Returns:
        The elapsed seconds.
    """
    start_s = time.monotonic()
    report_stage("place recognition")
    run_warm_up_frames(_StationaryOdometry)
    return time.monotonic() - start_s


class _StationaryOdometry:
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
