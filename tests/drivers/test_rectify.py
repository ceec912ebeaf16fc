"""Which camera a source has, its unit of depth, and whether depth is registered."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import CameraCalibration, DepthCameraCalibration, RigidTransform
from drivers.core import InputError
from drivers.openni2.source_properties import sensor_camera
from drivers.rectify import (
    CalibrationFile,
    DepthRegistration,
    Size,
    SourceProperties,
    factory_camera,
    make_rectifier,
)

SENSOR = SourceProperties(
    "openni2",
    factory_camera((640, 480), 570.3, 570.3),
    "factory",
    (640, 480),
    1000.0,
    DepthRegistration.YES,
)
PLAIN = CameraCalibration(640, 480, 520.0, 521.0, 322.0, 241.0, (0.0, 0.0, 0.0, 0.0, 0.0), 1000.0)
BESIDE = RigidTransform((-0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
WITH_DEPTH = replace(
    PLAIN,
    depth=DepthCameraCalibration(fx=580.0, fy=580.0, cx=320.0, cy=240.0, T_color_depth=BESIDE),
)
NO_FILE = CalibrationFile(None, None)


def choice(file: CameraCalibration) -> CalibrationFile:
    return CalibrationFile(Path("c.toml"), file)


@pytest.mark.parametrize("focal_px", [570.3, 601.0])
def test_a_sensor_reports_its_field_of_view(focal_px: float) -> None:
    fov_rad = 2 * math.atan(320 / focal_px), 2 * math.atan(240 / focal_px)
    camera, source = sensor_camera((640, 480), fov_rad)
    assert (camera.fx, camera.fy) == pytest.approx((focal_px, focal_px))
    assert (camera.cx, camera.cy, source) == (319.5, 239.5, "factory")


@pytest.mark.parametrize(("size", "focal_px"), [((640, 480), 525.0), ((320, 240), 262.5)])
def test_a_sensor_without_a_field_of_view_has_the_usual_one(size: Size, focal_px: float) -> None:
    assert sensor_camera(size, (0.0, 0.0)) == (factory_camera(size, focal_px, focal_px), "default")


def test_without_a_camera_file_the_camera_is_the_sources() -> None:
    rectifier = make_rectifier(SENSOR, NO_FILE)
    assert (rectifier.camera, rectifier.intrinsics_source) == (SENSOR.camera, "factory")


def test_camera_file_overrides_the_sensor() -> None:
    rectifier = make_rectifier(SENSOR, choice(PLAIN))
    assert rectifier.camera == PLAIN.pinhole
    assert rectifier.intrinsics_source == "camera file c.toml"


@pytest.mark.parametrize("registered", [DepthRegistration.YES, DepthRegistration.UNKNOWN])
def test_file_without_depth_table_assumes_registered_depth(registered: DepthRegistration) -> None:
    rectifier = make_rectifier(replace(SENSOR, registration=registered), choice(PLAIN))
    depth = np.full((480, 640), 2000, np.uint16)
    assert rectifier.rectify_depth(depth) is depth


@pytest.mark.parametrize("registered", [DepthRegistration.NO, DepthRegistration.UNKNOWN])
def test_file_with_depth_table_registers_in_software(registered: DepthRegistration) -> None:
    rectifier = make_rectifier(replace(SENSOR, registration=registered), choice(WITH_DEPTH))
    moved = rectifier.rectify_depth(np.full((480, 640), 2000, np.uint16))
    assert moved[240, 320] == 2000
    assert moved[240, 0] == 0  # 580 pixels of focal length shrink to 520


def test_scale_of_the_depth_table_is_in_the_factor() -> None:
    assert WITH_DEPTH.depth is not None
    scaled = replace(WITH_DEPTH, depth=replace(WITH_DEPTH.depth, scale=1.02))
    rectifier = make_rectifier(replace(SENSOR, registration=DepthRegistration.NO), choice(scaled))
    assert rectifier.depth_factor == pytest.approx(1000.0 / 1.02)


def test_small_correction_of_the_unit_is_accepted() -> None:
    assert (
        make_rectifier(SENSOR, choice(replace(PLAIN, depth_factor=1035.0))).depth_factor == 1035.0
    )


@pytest.mark.parametrize(
    ("source", "file", "complaint"),
    [
        (replace(SENSOR, registration=DepthRegistration.NO), None, "does not register its depth"),
        (replace(SENSOR, registration=DepthRegistration.NO), PLAIN, "does not register its depth"),
        (
            replace(SENSOR, registration=DepthRegistration.UNKNOWN),
            None,
            "does not store whether its depth",
        ),
        (SENSOR, WITH_DEPTH, "registers its depth and cannot switch that off"),
        (replace(SENSOR, depth_size=(320, 240)), None, "depth is 320x240, so it cannot"),
        (replace(SENSOR, depth_size=(320, 240)), PLAIN, "depth is 320x240, so it cannot"),
        (
            replace(SENSOR, camera=factory_camera((1280, 1024), 1050.0, 1050.0)),
            PLAIN,
            "color is 1280x1024, but camera file",
        ),
        (SENSOR, replace(PLAIN, depth_factor=5000.0), "set depth_factor = 1000.0"),
    ],
)
def test_mismatching_sizes_are_rejected_in_one_line(
    source: SourceProperties, file: CameraCalibration | None, complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint) as error:
        make_rectifier(source, NO_FILE if file is None else choice(file))
    assert "\n" not in str(error.value)
