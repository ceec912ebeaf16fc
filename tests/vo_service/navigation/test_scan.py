"""Scans of walls whose distance is known."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.navigation.views import CAMERA, frame_of, mounted, wall_on_floor
from vo_service.config_tables import ScanConfig
from vo_service.navigation.height_limits import mounting_problem
from vo_service.navigation.robot_scan import RobotScanner
from vo_service.navigation.scan import ScanAngles

LEVEL = np.eye(4)
quick = settings(max_examples=25, deadline=None)


def scan_of(frame: object, T_base_camera: Array, T_odom_base: Array = LEVEL) -> Array:
    scanner = RobotScanner(ScanConfig(), T_base_camera)
    ranges: Array = scanner.scan(frame, T_odom_base @ T_base_camera)[1].astype(np.float64)  # type: ignore[arg-type]
    return ranges


def angles_rad() -> Array:
    angles = ScanAngles.of_camera(CAMERA, np.radians(0.5))
    return angles.first_rad + angles.step_rad * np.arange(angles.bins, dtype=np.float64)


@given(st.floats(0.3, 1.2), st.floats(0.0, 20.0), st.floats(-0.05, 0.05), st.floats(1.0, 4.0))
@quick
def test_a_wall_is_where_it_is_from_any_mounting(
    height_m: float, down_deg: float, roll: float, wall_m: float
) -> None:
    T = mounted(height_m, down_deg, roll)
    ranges = scan_of(wall_on_floor(T, wall_m), T)
    expected = wall_m / np.cos(angles_rad())
    known = np.isfinite(ranges)
    assert np.count_nonzero(known & (expected < 4.4)) >= 0.9 * np.count_nonzero(expected < 4.4)
    # A window of three cells in 1/range, and half a direction at an oblique wall.
    np.testing.assert_allclose(ranges[known], expected[known], rtol=0.02)


@given(st.floats(0.3, 1.2), st.floats(-3.1, 3.1), st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))
@quick
def test_a_tilted_base_sees_the_same_wall(
    height_m: float, yaw: float, pitch: float, roll: float
) -> None:
    """A base with a known tilt is as a tilted camera on a level base."""
    tilt = so3_exp([0.0, pitch, 0.0]) @ so3_exp([roll, 0.0, 0.0])
    T_base_camera = mounted(height_m)
    T_level_camera = rigid_transform(tilt, np.zeros(3)) @ T_base_camera
    frame = wall_on_floor(T_level_camera, 2.0)
    T_odom_base = rigid_transform(so3_exp([0.0, 0.0, yaw]) @ tilt, (1.0, 2.0, 0.0))
    ranges = scan_of(frame, T_base_camera, T_odom_base)
    known = np.isfinite(ranges)
    assert np.count_nonzero(known) > 0.9 * len(ranges)
    expected = (2.0 - T_level_camera[0, 3]) / np.cos(angles_rad())
    np.testing.assert_allclose(ranges[known], expected[known], rtol=0.02)


def test_the_first_range_is_on_the_right() -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width))
    depth[:, 200:] = 2.0  # the right of the image
    ranges = scan_of(frame_of(depth), mounted(0.5))
    assert np.isfinite(ranges[0])
    assert np.isnan(ranges[-1])


def test_a_bare_floor_is_unknown_even_if_the_level_is_wrong_by_a_degree() -> None:
    T = mounted(0.5, 10.0)
    floor = wall_on_floor(T, 100.0)
    for error in (-1.0, 0.0, 1.0):
        tilt = rigid_transform(so3_exp([0.0, np.radians(error), 0.0]), np.zeros(3))
        assert np.all(np.isnan(scan_of(floor, T, tilt)))


def test_nothing_but_a_far_wall_is_free_and_no_reading_is_unknown() -> None:
    T = mounted(0.5)
    assert np.isposinf(scan_of(wall_on_floor(T, 6.0), T)).sum() > 100
    assert np.all(np.isnan(scan_of(frame_of(np.zeros((240, 320))), T)))
    # Above the band: the space below it may be occluded.
    assert np.all(np.isnan(scan_of(wall_on_floor(T, 2.0, low_m=0.7), T)))


def test_the_nearest_of_several_obstacles_counts() -> None:
    T = mounted(0.5)
    near, far = wall_on_floor(T, 1.5, high_m=0.3).depth_m, wall_on_floor(T, 3.0).depth_m
    both = np.where((near > 0) & (near < far) | (far == 0), near, far)
    ranges = scan_of(frame_of(both), T)
    np.testing.assert_allclose(ranges, 1.5 / np.cos(angles_rad()), rtol=0.02)


def test_what_is_nearer_than_the_least_range_is_unknown() -> None:
    T = mounted(0.5)
    assert np.all(np.isnan(scan_of(wall_on_floor(T, 0.3), T)))
    behind = np.where(np.arange(240)[:, None] < 60, 0.3, wall_on_floor(T, 2.0).depth_m)
    assert np.all(np.isnan(scan_of(frame_of(behind), T)))


def test_few_pixels_are_no_obstacle() -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width))
    depth[100, 100] = 2.0
    assert np.all(np.isnan(scan_of(frame_of(depth), mounted(0.5))))


@pytest.mark.parametrize("height_m", [0.0, 0.1, -0.3])
def test_a_camera_on_the_floor_knows_nothing(height_m: float) -> None:
    ranges = scan_of(wall_on_floor(mounted(0.5), 2.0), mounted(height_m))
    assert np.all(np.isnan(ranges))


def test_a_changed_tilt_or_camera_is_taken_into_account() -> None:
    T = mounted(0.5, 10.0)
    scanner = RobotScanner(ScanConfig(), T)
    wall = wall_on_floor(T, 2.0)
    level = scanner.scan(wall, T)[1]
    tilted = rigid_transform(so3_exp([0.0, -0.1, 0.0]), np.zeros(3))
    assert not np.array_equal(scanner.scan(wall, tilted @ T)[1], level, equal_nan=True)
    np.testing.assert_array_equal(scanner.scan(wall, T)[1], level)
    wide = replace(wall, camera=replace(CAMERA, fx=200.0))
    assert scanner.scan(wide, T)[0].bins > len(level)


@pytest.mark.parametrize(
    ("T_base_camera", "config", "text"),
    [
        (mounted(0.0), ScanConfig(), "set translation_m"),
        (mounted(0.5, -25.0), ScanConfig(), "sees no floor"),
        (mounted(2.5), ScanConfig(), "sees no floor"),
        (mounted(1.0, 10.0), ScanConfig(max_height_m=0.6), "below the camera"),
        (mounted(0.5, 10.0), ScanConfig(), "^$"),
        (mounted(1.5), ScanConfig(), "^$"),
    ],
)
def test_a_mounting_that_cannot_work_is_named(
    T_base_camera: Array, config: ScanConfig, text: str
) -> None:
    assert re.search(text, mounting_problem(config, T_base_camera))
