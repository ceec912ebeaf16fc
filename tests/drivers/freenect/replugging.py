"""A Kinect that comes and goes many times, and what is still held afterwards.

The camera and its base run in a process of their own, as in the service; this process reads.
"""

import ctypes
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from drivers.camera import CameraState, Clock, FrameTimeout, PlaybackMode, RgbdCamera, SensorConfig
from drivers.freenect.camera import make_kinect_camera
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.resource_leaks import child_pids, resident_memory_kb, resources_in_use_by
from tests.simulators.kinect_simulator import KinectSimulator
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until

# The back-off is not what is looked at, nor how busy the machine is.
FAST_TIMEOUTS = Timeouts(
    opening_s=DEFAULT_TIMEOUT_S,
    heartbeat_s=DEFAULT_TIMEOUT_S,
    initial_retry_s=0.01,
    max_retry_s=0.01,
)


# Of mallopt(3).
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3


# The camera, and the motor or the audio device that drives it.
OPEN_HANDLES = 2


@dataclass(frozen=True)
class HeldResources:
    """What the two processes hold while the Kinect streams, and what is open at the Kinect.

    Attributes:
        kinect: Open handles, and transfers that were abandoned so far.
        memory_kb: Resident, of the driver's process.
    """

    here: Counter[str]
    driver: Counter[str]
    kinect: tuple[int, int]
    memory_kb: int


@contextmanager
def kinect_in_subprocess() -> Iterator[SubprocessCamera]:
    """The first Kinect that the environment shows, open."""
    recipe = partial(_make_camera_that_frees_at_once, "", SensorConfig(), None)
    with SubprocessCamera(
        "freenect", Clock.MONOTONIC, recipe, PlaybackMode.REALTIME, FAST_TIMEOUTS
    ) as camera:
        yield camera


def _make_camera_that_frees_at_once(*arguments: Any) -> RgbdCamera:
    """In the driver's process: what is freed leaves its memory at once, so that a leak shows."""
    for parameter, value in ((M_TRIM_THRESHOLD, 0), (M_MMAP_THRESHOLD, 1 << 16)):
        ctypes.CDLL(None).mallopt(parameter, value)
    return make_kinect_camera(*arguments)


def replug(camera: SubprocessCamera, kinect: KinectSimulator) -> None:
    """Unplug it while it streams and plug it in again, until all of it is open again.

    A frame alone does not say so: the last one of before may still come after the plug.
    """
    kinect.unplug()
    wait_until(lambda: camera.status.state is not CameraState.STREAMING)
    _discard_buffered_frames(camera)
    kinect.plug()
    camera.read(DEFAULT_TIMEOUT_S)
    wait_until(
        lambda: camera.status.state is CameraState.STREAMING and kinect.open_handles == OPEN_HANDLES
    )


def count_resources(kinect: KinectSimulator) -> HeldResources:
    """Now; the driver's process is the only one that was started here."""
    (driver,) = child_pids()
    at_kinect = kinect.open_handles, kinect.abandoned_transfers
    return HeldResources(
        resources_in_use_by(os.getpid()),
        resources_in_use_by(driver),
        at_kinect,
        resident_memory_kb(driver),
    )


def _discard_buffered_frames(camera: SubprocessCamera) -> None:
    try:
        while True:
            camera.read(0.0)
    except FrameTimeout:
        return
