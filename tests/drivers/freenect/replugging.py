"""A Kinect that comes and goes many times, and what is still held afterwards.

The camera and its base run in a process of their own, as in the service; this process reads.
"""

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from drivers.camera import CameraState, Clock, NoFrameYet, Pace
from drivers.freenect.recipes import kinect_camera
from drivers.isolation.camera import IsolatedCamera
from drivers.isolation.limits import TimeLimits
from drivers.sensor_settings import SensorSettings
from tests.belongings import belongings_of, children, resident_kb
from tests.stand_ins.played_kinect import PlayedKinect
from tests.waiting import PATIENCE_S, wait_until

# The back-off is not what is looked at, nor how busy the machine is.
AT_ONCE = TimeLimits(
    opening_s=PATIENCE_S, heartbeat_s=PATIENCE_S, first_retry_s=0.01, longest_retry_s=0.01
)


@dataclass(frozen=True)
class Held:
    """What the two processes hold while the Kinect streams, and what is open at the Kinect.

    kinect     open handles, and transfers that were abandoned so far
    memory_kb  resident, of the driver's process
    """

    here: Counter[str]
    driver: Counter[str]
    kinect: tuple[int, int]
    memory_kb: int


@contextmanager
def isolated_kinect() -> Iterator[IsolatedCamera]:
    """The first Kinect that the environment shows, open."""
    recipe = partial(kinect_camera, "", SensorSettings(), None)
    with IsolatedCamera("freenect", Clock.MONOTONIC, recipe, Pace.REALTIME, AT_ONCE) as camera:
        yield camera


def replug(camera: IsolatedCamera, kinect: PlayedKinect) -> None:
    """Unplug it while it streams and plug it in again, until it streams again."""
    kinect.unplug()
    wait_until(lambda: camera.condition.state is not CameraState.STREAMING)
    _forget_what_came_before(camera)
    kinect.plug()
    camera.read(PATIENCE_S)


def held(kinect: PlayedKinect) -> Held:
    """Now; the driver's process is the only one that was started here."""
    (driver,) = children()
    at_kinect = kinect.open_handles, kinect.abandoned_transfers
    return Held(belongings_of(os.getpid()), belongings_of(driver), at_kinect, resident_kb(driver))


def _forget_what_came_before(camera: IsolatedCamera) -> None:
    try:
        while True:
            camera.read(0.0)
    except NoFrameYet:
        return
