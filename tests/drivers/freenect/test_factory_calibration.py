import logging
from dataclasses import replace
from math import cos, nan, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.freenect.factory_calibration import (
    MAX_DEPTH_MM,
    MAX_FOCAL_DEVIATION,
    USUAL_COLOR_FOCAL_PX,
    FactoryCalibration,
    ValidDepthMask,
    all_depths_to_10_m,
    find_valid_depths_mm,
)
from tests.drivers.freenect.conftest import MakeCamera, plug_in
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_registration import make_factory_table, raw_to_mm
from tests.simulators.kinect_simulator import FACTORY, IDENTITY, KinectModel

DEPTH_PX = np.mgrid[160:480:8, 120:360:8].reshape(2, -1).T.astype(np.float64)


def calibration(color_focal_px: float, roll_rad: float = 0.0) -> FactoryCalibration:
    """A calibration whose color camera is turned about its axis and shifted."""
    turn = np.array([[cos(roll_rad), -sin(roll_rad)], [sin(roll_rad), cos(roll_rad)]])
    color_px = color_focal_px / 575.8 * DEPTH_PX @ turn.T + (28.0, 30.0)
    return FactoryCalibration(575.8, DEPTH_PX, color_px)


def table(*ends: int) -> np.ndarray[tuple[int], np.dtype[np.uint16]]:
    """A table as libfreenect's: 1000 values that rise from 400 mm, then `ends`."""
    return np.array([*range(400, 5400, 5), *ends], dtype=np.uint16)


def test_ambiguous_wrapped_values_are_invalid() -> None:
    measured = find_valid_depths_mm(table(20_000, 61_000, 5000, 7000, 0))
    assert set(measured) == set(range(400, 5400, 5)) - {5000}


def test_without_a_far_range_the_table_ends_where_it_decreases() -> None:
    assert find_valid_depths_mm(table(300, 401, 0)).tolist() == list(range(400, 5400, 5))


@pytest.mark.slow
@given(st.lists(st.integers(0, 65535), max_size=300))
def test_only_the_increasing_part_below_10_m_is_valid(ends: list[int]) -> None:
    values = table(*ends)
    measured = set(find_valid_depths_mm(values).tolist())
    for raw, mm in enumerate(values.tolist()):
        if mm in measured:
            assert mm < MAX_DEPTH_MM
            assert (values[: raw + 1] == np.maximum.accumulate(values[: raw + 1])).all()


def test_the_filter_sets_invalid_depth_to_0() -> None:
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    kept = ValidDepthMask(find_valid_depths_mm(table(5000)))(every)
    assert set(np.unique(kept)) == {0} | set(range(400, 5400, 5)) - {5000}
    assert (kept[kept > 0] == every[kept > 0]).all()
    assert np.array_equal(
        ValidDepthMask(all_depths_to_10_m())(every), every * (every < MAX_DEPTH_MM)
    )


def test_a_kinects_own_table_is_split_at_the_pole_of_its_formula(
    simulate_kinect: SimulateKinect, make_camera: MakeCamera
) -> None:
    plug_in(simulate_kinect, registration=FACTORY)
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    with make_camera() as camera:
        kept = camera._depth_filter(every)
    usable = set(raw_to_mm(np.arange(2048, dtype=np.uint16)).tolist()) - {0}
    assert set(np.unique(kept)) - {0} <= usable
    assert len(usable - set(np.unique(kept))) < 0.01 * len(usable)


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
