"""Cameras on a played Kinect, in this process."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.freenect.camera import FreenectCamera
from drivers.freenect.images import Images
from drivers.freenect.kinect import Kinect
from drivers.freenect.library import PACKAGE, SONAME
from drivers.kinect_usb.base import Base, NoBase
from drivers.sensor_settings import SensorSettings
from tests.stand_ins.fixtures import PlayKinect
from tests.stand_ins.needed import need_library
from tests.stand_ins.played_kinect import IDENTITY, PlayedKinect

MakeCamera = Callable[..., FreenectCamera]


@pytest.fixture
def kinect(play_kinect: PlayKinect) -> PlayedKinect:
    """A 1414 whose film is registered already, so that what comes back is known exactly."""
    return plug_in(play_kinect)


@pytest.fixture
def make_camera() -> Iterator[MakeCamera]:
    """A function that makes cameras; they are closed when the test ends."""
    with ExitStack() as stack:

        def make(
            serial: str = "",
            settings: SensorSettings = SensorSettings(),  # noqa: B008 (frozen)
            camera_file: Path | None = None,
            base: Base = NoBase(),  # noqa: B008 (nothing in it)
        ) -> FreenectCamera:
            images = Images(camera_file, settings.mirror)
            camera = FreenectCamera(Kinect(serial, settings), images, base, settings)
            stack.callback(camera.close)
            return camera

        yield make


def plug_in(play_kinect: PlayKinect, **options: Any) -> PlayedKinect:
    """Plug it in where this process sees it; skips without libfreenect."""
    kinect = play_kinect(**{"registration": IDENTITY} | options)
    kinect.load()
    need_library(SONAME, PACKAGE)
    return kinect
