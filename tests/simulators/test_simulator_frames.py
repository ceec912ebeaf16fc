"""The frames that the real libfreenect reads from a simulated Kinect."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from tests.simulators.fixtures import SimulateKinect, pattern_frame
from tests.simulators.freenect_probe import (
    DEPTH_MM,
    DEPTH_REGISTERED,
    FreenectProbe,
    capture_kinect,
)
from tests.simulators.kinect_registration import RegistrationTable
from tests.simulators.kinect_simulator import (
    FACTORY,
    IDENTITY,
)
from tests.simulators.raw_depth import NOMINAL, RawDepthScale, raw_to_mm
from tests.simulators.usb_frames import write_usb_frames

pytestmark = pytest.mark.usefixtures("real_libfreenect")
TICKS_A_FRAME = 2_000_000


class _Registration(ctypes.Structure):
    """libfreenect's 176 bytes; only the address of the table is used here."""

    _fields_ = (
        ("before", ctypes.c_uint8 * 152),
        ("raw_to_mm", ctypes.POINTER(ctypes.c_uint16)),
        ("after", ctypes.c_uint8 * 16),
    )


@pytest.mark.parametrize("registration", [FACTORY, IDENTITY], ids=["factory", "identity"])
@pytest.mark.parametrize("scale", [NOMINAL, RawDepthScale(7.5128, 119.79)], ids=["nominal", "own"])
def test_the_table_of_millimeters_is_libfreenects_own(
    simulate_kinect: SimulateKinect,
    tmp_path: Path,
    registration: RegistrationTable,
    scale: RawDepthScale,
) -> None:
    simulate_kinect(
        write_usb_frames(tmp_path, [pattern_frame(0)], scale=scale), registration=registration
    ).activate()
    with FreenectProbe() as probe:
        probe.start(DEPTH_MM)
        table = _table_of(probe)
    ours = raw_to_mm(np.arange(2048, dtype=np.uint16), scale)
    usable = ours > 0
    assert np.array_equal(ours[usable], table[usable])
    assert usable.sum() > 1000


def _table_of(probe: FreenectProbe) -> np.ndarray[tuple[int], np.dtype[np.uint16]]:
    copy = probe.lib.freenect_copy_registration
    copy.restype, copy.argtypes = _Registration, [ctypes.c_void_p]
    registration = copy(probe.device)
    table = np.ctypeslib.as_array(registration.raw_to_mm, (2048,)).copy()
    probe.lib.freenect_destroy_registration(ctypes.byref(registration))
    return table


def test_a_factory_kinect_moves_a_wall_by_its_parallax(
    simulate_kinect: SimulateKinect, tmp_path: Path
) -> None:
    """A post 1.5 m away is at its place in the color image."""
    column, depth_mm, behind_mm = 200, 1500, 4000
    depth = np.full((480, 640), behind_mm, np.uint16)
    depth[:, column - 8 : column + 9] = depth_mm
    frames = write_usb_frames(tmp_path, [(np.zeros((480, 640, 3), np.uint8), depth)])
    probe = capture_kinect(simulate_kinect(frames), frames=1, depth=DEPTH_REGISTERED)
    near = np.flatnonzero(abs(probe.depth.images[0][240].astype(int) - depth_mm) < 20)
    ray = (column - 319.5) / NOMINAL.focal_px
    expected = 319.5 + 525.0 * (ray - 24.0 * NOMINAL.focal_px / 525.0 / depth_mm)
    assert near.mean() == pytest.approx(expected, abs=1.0)
