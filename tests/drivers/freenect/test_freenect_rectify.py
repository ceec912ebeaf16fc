from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import (
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
    SoftwareRegistration,
    format_calibration,
)
from drivers.core import InputError
from drivers.freenect.bindings import DepthFormat
from drivers.freenect.rectify import DEFAULT_CALIBRATION, KinectRectifier
from tests.drivers.freenect.conftest import MakeCamera
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.kinect_registration import quantize_mm
from tests.simulators.kinect_simulator import KinectSimulator

OWN_CAMERA = DepthCameraCalibration(
    575.8, 575.8, 319.5, 239.5, RigidTransform((0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), scale=1.02
)


def written(camera: CameraCalibration, folder: Path) -> Path:
    file = folder / "camera.toml"
    file.write_text(format_calibration(camera))
    return file


def test_depth_with_its_own_camera_is_registered_in_software(
    kinect: KinectSimulator, make_camera: MakeCamera, tmp_path: Path
) -> None:
    file = written(replace(DEFAULT_CALIBRATION, depth=OWN_CAMERA), tmp_path)
    with make_camera(camera_file=file) as camera:
        frame = camera.read(3.0)
    registration = SoftwareRegistration(DEFAULT_CALIBRATION.pinhole, OWN_CAMERA, 1000.0)
    unregistered = [quantize_mm(pattern_frame(seq)[1]) for seq in range(FRAME_COUNT)]
    expected = [registration.register(depth_mm) for depth_mm in unregistered]
    assert any(np.array_equal(frame.depth_raw, depth) for depth in expected)
    assert frame.depth_factor == pytest.approx(1000.0 / 1.02)


def test_the_requested_depth_format_depends_on_the_camera_file(tmp_path: Path) -> None:
    own = written(replace(DEFAULT_CALIBRATION, depth=OWN_CAMERA), tmp_path)
    assert KinectRectifier(own, is_mirrored=False).depth_format is DepthFormat.MM
    assert KinectRectifier(None, is_mirrored=False).depth_format is DepthFormat.REGISTERED_MM


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (replace(DEFAULT_CALIBRATION, width=600, height=450), "this file is for 600x450"),
        (
            replace(DEFAULT_CALIBRATION, depth=replace(OWN_CAMERA, width=600)),
            r"\[depth\] of this file",
        ),
        (replace(DEFAULT_CALIBRATION, depth_factor=5000.0), "set depth_factor = 1000.0"),
    ],
)
def test_a_file_for_another_image_size_is_rejected(
    camera: CameraCalibration, words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        KinectRectifier(written(camera, tmp_path), is_mirrored=False)
