"""Frames that are sent from memory at the frame rate, without odometry."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from drivers.camera import RgbdFrame
from drivers.playback.camera import RecordingCamera
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

RATE_HZ = 30.0
WARM_UP_FRAMES = 60
Item = TypeVar("Item", RgbdFrame, OdometryUpdate)


def load_frames(recording: Path, count: int) -> list[RgbdFrame]:
    """The first frames of a recording."""
    with RecordingCamera(recording) as camera:
        return list(islice(camera, count))


def make_update(frame: RgbdFrame) -> OdometryUpdate:
    """Make the update of a camera at rest that sees the frame, with its number and stamp."""
    identity, covariance = np.eye(4), np.eye(6)
    return OdometryUpdate(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        state=TrackingState.TRACKING,
        reason="",
        epoch=1,
        T_world_camera=identity,
        T_odom_base=identity,
        T_odom_camera=identity,
        pose_covariance=covariance,
        twist=np.zeros(6),
        twist_covariance=covariance,
        frame=frame,
        estimate=Estimate(True, "", identity, identity, covariance),
        stage_ms={},
        latency_s=0.0,
    )


def send_in_turn(
    items: Sequence[Item], first: int, count: int, send: Callable[[Item], None]
) -> list[float]:
    """Send frames or updates in turn at the frame rate, with new numbers and stamps.

    Returns:
        Seconds that each call took.
    """
    begin_s, taken_s = time.monotonic(), []
    for i in range(count):
        time.sleep(max(0.0, begin_s + i / RATE_HZ - time.monotonic()))
        item = replace(items[(first + i) % len(items)], seq=first + i, stamp_s=time.time())
        started_s = time.perf_counter()
        send(item)
        taken_s.append(time.perf_counter() - started_s)
    # The next call goes on at the same rate.
    time.sleep(max(0.0, begin_s + count / RATE_HZ - time.monotonic()))
    return taken_s
