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
from tests.vo_service.outputs import sample_updates
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate

RATE_HZ = 30.0
WARM_UP_FRAMES = 60
Item = TypeVar("Item", RgbdFrame, OdometryUpdate)


def load_frames(recording: Path, count: int) -> list[RgbdFrame]:
    """The first frames of a recording."""
    with RecordingCamera(recording) as camera:
        return list(islice(camera, count))


def make_update(frame: RgbdFrame) -> OdometryUpdate:
    """Make the update of a frame, with its number and stamp."""
    estimate = Estimate(True, "", np.eye(4), np.eye(4), np.eye(6))
    sample = sample_updates.make_update(frame.seq)
    return replace(sample, stamp_s=frame.stamp_s, frame=frame, estimate=estimate)


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
