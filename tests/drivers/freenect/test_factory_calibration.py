import logging
from dataclasses import replace
from math import cos, nan, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.freenect.factory_calibration import (
    MAX_FOCAL_DEVIATION,
    USUAL_COLOR_FOCAL_PX,
    FactoryCalibration,
)
from tests.drivers.freenect.conftest import MakeCamera, plug_in
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_registration import make_factory_table
from tests.simulators.kinect_simulator import IDENTITY, KinectModel

DEPTH_PX = np.mgrid[160:480:8, 120:360:8].reshape(2, -1).T.astype(np.float64)


def calibration(color_focal_px: float, roll_rad: float = 0.0) -> FactoryCalibration:
    """A calibration whose color camera is turned about its axis and shifted."""
    turn = np.array([[cos(roll_rad), -sin(roll_rad)], [sin(roll_rad), cos(roll_rad)]])
    color_px = color_focal_px / 575.8 * DEPTH_PX @ turn.T + (28.0, 30.0)
    return FactoryCalibration(575.8, DEPTH_PX, color_px)


@pytest.mark.parametrize("model", list(KinectModel))
def test_a_kinects_own_calibration_gives_the_focal_length(
    model: KinectModel, simulate_kinect: SimulateKinect, make_camera: MakeCamera
) -> None:
    plug_in(simulate_kinect, model=model, registration=make_factory_table(513.0))
    with make_camera() as camera:
        frame = camera.read(3.0)
        assert camera.intrinsics_source == "factory"
    assert frame.camera.fx == frame.camera.fy == pytest.approx(513.0, abs=0.3)
    assert (frame.camera.cx, frame.camera.cy) == (319.5, 239.5)


def test_an_implausible_calibration_is_reported_once_and_not_used(
    simulate_kinect: SimulateKinect, make_camera: MakeCamera, caplog: pytest.LogCaptureFixture
) -> None:
    plug_in(simulate_kinect, registration=IDENTITY)
    camera = make_camera()
    for _ in range(2):
        with camera:
            assert camera.read(3.0).camera.fx == USUAL_COLOR_FOCAL_PX
            assert camera.intrinsics_source == "default"
    (record,) = [r for r in caplog.records if r.levelno >= logging.WARNING]
    assert "would be 0.0005491 px, but Kinects have 575.8 px ± 5%" in record.getMessage()


@given(st.floats(500.0, 550.0), st.floats(-0.1, 0.1))
def test_the_focal_length_does_not_depend_on_how_the_cameras_are_turned(
    focal_px: float, roll_rad: float
) -> None:
    assert calibration(focal_px, roll_rad).color_focal_px() == pytest.approx(focal_px)


@given(st.data())
def test_no_focal_length_far_from_a_kinects_is_accepted(data: st.DataObject) -> None:
    numbers = st.integers(-(2**31), 2**31 - 1)
    corners = data.draw(st.lists(numbers, min_size=4, max_size=4))
    color_px = np.resize(np.array(corners, dtype=np.float64) / 256.0, DEPTH_PX.shape)
    depth_focal_px = data.draw(st.floats(width=32))
    try:
        focal_px = FactoryCalibration(depth_focal_px, DEPTH_PX, color_px).color_focal_px()
    except ValueError:
        return
    assert abs(focal_px / USUAL_COLOR_FOCAL_PX - 1.0) <= MAX_FOCAL_DEVIATION


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (replace(calibration(525.0), depth_focal_px=nan), "depth camera would be nan px"),
        (calibration(480.0), "color camera would be 480 px"),
        (
            replace(calibration(525.0), color_px=DEPTH_PX * (0.89, 0.93)),
            "registration stretches by 4.5%",
        ),
        (
            replace(calibration(525.0), color_px=DEPTH_PX + np.sin(DEPTH_PX) * 9.0),
            "px off a straight map",
        ),
    ],
)
def test_the_reason_of_an_implausible_calibration(bad: FactoryCalibration, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        bad.color_focal_px()
