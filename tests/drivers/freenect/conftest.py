"""Cameras on a played Kinect, in this process."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.calibration import NO_DISTORTION, CameraCalibration
from drivers.camera import SensorConfig
from drivers.freenect.bindings import PACKAGE, SONAME
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.sources import KinectSource
from drivers.kinect_usb.motor_unit import MotorUnit
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator
from tests.simulators.requirements import require_library

# A camera file with the usual values.
KINECT_CALIBRATION = CameraCalibration(
    640, 480, 525.0, 525.0, 319.5, 239.5, NO_DISTORTION, depth_factor=1000.0
)

MakeCamera = Callable[..., FreenectCamera]


@pytest.fixture
def kinect(simulate_kinect: SimulateKinect) -> KinectSimulator:
    """A 1414 whose sequence is registered already, so that what comes back is known exactly."""
    return plug_in(simulate_kinect)


@pytest.fixture
def make_camera() -> Iterator[MakeCamera]:
    """A function that makes cameras; they are closed when the test ends."""
    with ExitStack() as stack:

        def make(
            serial: str = "",
            settings: SensorConfig = SensorConfig(),  # noqa: B008 (frozen)
            camera_file: Path | None = None,
            motor_unit: MotorUnit = MotorUnit(),  # noqa: B008 (nothing in it)
        ) -> FreenectCamera:
            source = KinectSource(serial, settings)
            camera = FreenectCamera(source, camera_file, motor_unit, settings)
            stack.callback(camera.close)
            return camera

        yield make


def plug_in(simulate_kinect: SimulateKinect, **options: Any) -> KinectSimulator:
    """Plug it in where this process sees it; skips without libfreenect."""
    kinect = simulate_kinect(**{"registration": IDENTITY} | options)
    kinect.activate()
    require_library(SONAME, PACKAGE)
    return kinect
