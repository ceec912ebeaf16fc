"""The images that are converted here are those that libfreenect itself would deliver."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import DepthCameraCalibration, RigidTransform, format_calibration
from drivers.freenect.conversion import DUMP_CONVERSION
from drivers.freenect.depth_tables import MAX_DEPTH_MM, find_valid_depths_mm
from drivers.rectify import SoftwareRegistration
from tests.drivers.freenect.conftest import KINECT_CALIBRATION, MakeCamera, plug_in
from tests.simulators.fixtures import SimulateKinect, pattern_frame
from tests.simulators.freenect_probe import DEPTH_MM, DEPTH_REGISTERED, capture_kinect
from tests.simulators.kinect_registration import RegistrationTable, make_factory_table, raw_to_mm
from tests.simulators.kinect_simulator import FACTORY, IDENTITY, KinectSimulator, write_usb_frames
from tests.simulators.usb_frames import HEADER_BYTES

FRAMES = 2


def plug_in_noise(
    simulate_kinect: SimulateKinect, folder: Path, registration: RegistrationTable
) -> KinectSimulator:
    """A Kinect whose images hold every raw value and color at random."""
    frames = write_usb_frames(folder, (pattern_frame(seq) for seq in range(FRAMES)))
    noise = np.random.default_rng(1).bytes(frames.file.stat().st_size - HEADER_BYTES)
    with frames.file.open("r+b") as file:
        file.seek(HEADER_BYTES)
        file.write(noise)
    return plug_in(simulate_kinect, frames=frames, registration=registration)


def keep_valid(depth_mm: np.ndarray) -> np.ndarray:
    """Set distances to 0 that a raw value without reading has too."""
    table = raw_to_mm(np.arange(2048, dtype=np.uint16))
    return np.where(np.isin(depth_mm, find_valid_depths_mm(table)), depth_mm, 0)


@pytest.mark.parametrize("registration", [FACTORY, IDENTITY, make_factory_table(560.0)])
def test_pixels_are_those_of_libfreenect(
    registration: RegistrationTable,
    simulate_kinect: SimulateKinect,
    make_camera: MakeCamera,
    tmp_path: Path,
) -> None:
    kinect = plug_in_noise(simulate_kinect, tmp_path, registration)
    probe = capture_kinect(kinect, FRAMES + 1, DEPTH_REGISTERED)
    with make_camera() as camera:
        frames = [camera.read(3.0) for _ in range(3)]
    colors = [image[..., ::-1] for image in probe.video.images]
    depths = [keep_valid(image) for image in probe.depth.images]
    assert np.count_nonzero(depths[0]) > 30_000
    for frame in frames:
        assert any(np.array_equal(frame.color_bgr, color) for color in colors)
        assert any(np.array_equal(frame.depth_raw, depth) for depth in depths)


def test_unregistered_depth_is_that_of_libfreenect(
    simulate_kinect: SimulateKinect, make_camera: MakeCamera, tmp_path: Path
) -> None:
    kinect = plug_in_noise(simulate_kinect, tmp_path, FACTORY)
    probe = capture_kinect(kinect, FRAMES + 1, DEPTH_MM)
    beside = RigidTransform((0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    depth = DepthCameraCalibration(575.8, 575.8, 319.5, 239.5, beside)
    file = tmp_path / "camera.toml"
    file.write_text(format_calibration(replace(KINECT_CALIBRATION, depth=depth)))
    with make_camera(camera_file=file) as camera:
        frame = camera.read(3.0)
    register = SoftwareRegistration(KINECT_CALIBRATION.pinhole, depth, 1000.0).register
    expected = [register(keep_valid(image).astype(np.uint16)) for image in probe.depth.images]
    assert any(np.array_equal(frame.depth_raw, image) for image in expected)


def test_a_dump_keeps_depths_below_10_m_and_swaps_red_and_blue() -> None:
    depth_mm = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    color_rgb = np.array([[[1, 2, 3]]], np.uint8)
    kept, color_bgr = np.empty_like(depth_mm), np.empty_like(color_rgb)
    DUMP_CONVERSION.to_mm(depth_mm, kept)
    DUMP_CONVERSION.to_bgr(color_rgb, color_bgr)
    assert np.array_equal(kept, depth_mm * (depth_mm < MAX_DEPTH_MM))
    assert color_bgr.tolist() == [[[3, 2, 1]]]
