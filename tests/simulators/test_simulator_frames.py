"""The frames that the real libfreenect reads from a simulated Kinect."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from tests.simulators.fixtures import FRAME_COUNT, SimulateKinect, pattern_frame
from tests.simulators.freenect_probe import (
    DEPTH_MM,
    DEPTH_REGISTERED,
    VIDEO_INFRARED_8,
    FreenectProbe,
    capture_kinect,
)
from tests.simulators.kinect_registration import RegistrationTable
from tests.simulators.kinect_simulator import (
    FACTORY,
    IDENTITY,
    KinectModel,
    KinectStream,
    simulator_environment,
)
from tests.simulators.raw_depth import NOMINAL, RawDepthScale, mm_to_raw, quantize_mm, raw_to_mm
from tests.simulators.usb_frames import write_usb_frames

pytestmark = pytest.mark.usefixtures("real_libfreenect")
TICKS_A_FRAME = 2_000_000


def frame_index(stamp: int) -> int:
    return stamp // TICKS_A_FRAME % FRAME_COUNT


def test_raw_depth_comes_bit_for_bit(simulate_kinect: SimulateKinect) -> None:
    probe = capture_kinect(simulate_kinect(), frames=10)
    for stamp, image in zip(probe.depth.stamps, probe.depth.images, strict=True):
        assert np.array_equal(image, mm_to_raw(pattern_frame(frame_index(stamp))[1]))


def test_color_survives_the_mosaic(simulate_kinect: SimulateKinect) -> None:
    probe = capture_kinect(simulate_kinect(), frames=3)
    for stamp, rgb in zip(probe.video.stamps, probe.video.images, strict=True):
        error = rgb[2:-2, 2:-2, ::-1].astype(int) - pattern_frame(frame_index(stamp))[0][2:-2, 2:-2]
        assert np.percentile(abs(error), 98) <= 1


def test_millimeters_follow_the_table(simulate_kinect: SimulateKinect) -> None:
    probe = capture_kinect(simulate_kinect(), frames=2, depth=DEPTH_MM)
    expected = quantize_mm(pattern_frame(frame_index(probe.depth.stamps[0]))[1])
    assert np.array_equal(probe.depth.images[0], expected)


@pytest.mark.parametrize("model", KinectModel)
def test_registered_depth_stays_where_it_is(
    simulate_kinect: SimulateKinect, model: KinectModel
) -> None:
    kinect = simulate_kinect(model=model, registration=IDENTITY)
    probe = capture_kinect(kinect, frames=2, depth=DEPTH_REGISTERED)
    expected = quantize_mm(pattern_frame(frame_index(probe.depth.stamps[0]))[1])
    assert np.array_equal(probe.depth.images[0], expected)


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


def test_infrared_comes_in_place_of_color(simulate_kinect: SimulateKinect, tmp_path: Path) -> None:
    infrared = (np.mgrid[0:488, 0:640][1] + 100).astype(np.uint16)
    kinect = simulate_kinect(write_usb_frames(tmp_path, [pattern_frame(0)], [infrared]))
    kinect.activate()
    with FreenectProbe() as probe:
        probe.start(video=VIDEO_INFRARED_8)
        probe.capture(1)
    assert np.array_equal(probe.video.images[0], (infrared >> 2).astype(np.uint8))


def test_two_kinects_are_distinguished_by_their_serials(
    simulate_kinect: SimulateKinect, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other_frames = write_usb_frames(tmp_path, [pattern_frame(5)])
    first, second = simulate_kinect(serial="A1"), simulate_kinect(other_frames, serial="B2")
    first.activate()
    monkeypatch.setenv("KINECT_SIMULATOR", simulator_environment(first, second)["KINECT_SIMULATOR"])
    with FreenectProbe(serial="B2") as probe:
        assert probe.serials() == ["A1", "B2"]
        probe.start()
        probe.capture(1)
    assert np.array_equal(probe.depth.images[0], mm_to_raw(pattern_frame(5)[1]))
    assert first.frames_sent == (0, 0)


def test_the_later_models_are_identified_by_their_audio_device(
    simulate_kinect: SimulateKinect,
) -> None:
    simulate_kinect(model=KinectModel.K1473, serial="C3").activate()
    with FreenectProbe(serial="C3") as probe:
        assert probe.open_result == 0
        assert probe.serials() == ["C3"]


def test_stopping_leaves_nothing_behind(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    capture_kinect(kinect, frames=1)
    assert kinect.streaming == (False, False)
    assert kinect.open_handles == 0
    assert kinect.submitted_transfers == (0, 0)
    assert kinect.abandoned_transfers == 0
    assert min(kinect.frames_sent) >= 1
    assert kinect.packets_lost[KinectStream.DEPTH] == 0
