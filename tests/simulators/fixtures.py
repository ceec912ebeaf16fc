"""Fixtures of the Kinect simulator; tests/conftest.py provides them to all tests."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core import UserFacingError
from drivers.openni2.bindings import SONAME as LIBOPENNI2
from tests.simulators.freenect_probe import SONAME as LIBFREENECT
from tests.simulators.kinect_simulator import KinectSimulator
from tests.simulators.libusb_build import SONAME, libusb_folder
from tests.simulators.requirements import require_fakenect, require_library, skip_or_fail
from tests.simulators.usb_frames import UsbFrames, write_usb_frames

FRAME_COUNT = 8
SimulateKinect = Callable[..., KinectSimulator]


def pattern_frame(seq: int) -> tuple[np.ndarray[Any, np.dtype[np.uint8]], Any]:
    """Make frame `seq` of most tests: BGR and depth in millimeters; all frames differ.

    Color is smooth, so that the Bayer mosaic changes it by a few gray levels only. Depth is a slope
    from 0.6 to 3.5 m with a hole.
    """
    rows, columns = np.ogrid[0:480, 0:640]
    bgr = np.empty((480, 640, 3), np.uint8)
    for channel, level in enumerate(
        (columns // 4 + 16 * seq, rows // 3 + 8 * seq, (rows + columns) // 6)
    ):
        bgr[..., channel] = level % 256
    depth_mm = 600 + 10 * seq + 4 * columns + rows // 2
    depth_mm[200:220, 300:340] = 0
    return bgr, depth_mm.astype(np.uint16)


@pytest.fixture(scope="session", autouse=True)
def no_real_usb() -> None:
    """Hide this machine's USB devices from all tests.

    A process has one libusb, so the simulated one must be loaded before the system's. Without a C
    compiler nothing is loaded.
    """
    with suppress(UserFacingError):
        ctypes.CDLL(str(libusb_folder() / SONAME), mode=ctypes.RTLD_GLOBAL)


@pytest.fixture(scope="session")
def simulated_libusb() -> Path:
    """Folder of the simulated libusb; skips the test if it cannot be compiled."""
    try:
        return libusb_folder()
    except UserFacingError as error:
        skip_or_fail(str(error))


@pytest.fixture(scope="session")
def real_libfreenect(simulated_libusb: Path) -> None:
    """The real libfreenect on the simulated libusb; skips the test if it is not installed."""
    require_library(LIBFREENECT, "libfreenect0.5")


@pytest.fixture(scope="session")
def real_openni2() -> None:
    """The real libOpenNI2; skips the test if it is not installed."""
    require_library(LIBOPENNI2, "libopenni2-0")


@pytest.fixture(scope="session")
def fakenect() -> Path:
    """File of libfreenect's fakenect; skips the test if it is not installed."""
    return require_fakenect()


@pytest.fixture(scope="session")
def kinect_frames(tmp_path_factory: pytest.TempPathFactory) -> UsbFrames:
    """A quarter of a second of `pattern_frame`, to be looped."""
    frames = (pattern_frame(seq) for seq in range(FRAME_COUNT))
    return write_usb_frames(tmp_path_factory.mktemp("usb-frames"), frames)


@pytest.fixture
def simulate_kinect(
    tmp_path: Path, simulated_libusb: Path, kinect_frames: UsbFrames
) -> Iterator[SimulateKinect]:
    """A function that plugs in a Kinect until the test ends, with options of `KinectSimulator`.

    The Kinect waits for its reader: a test does not fail because the machine is busy.
    """
    with ExitStack() as stack:

        def simulate(frames: UsbFrames = kinect_frames, **options: Any) -> KinectSimulator:
            kinect = stack.enter_context(KinectSimulator(tmp_path, frames, **options))
            kinect.waits_for_reader = True
            return kinect

        yield simulate
