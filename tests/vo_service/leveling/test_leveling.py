"""How `odom` is kept level, from frames to corrections."""

from dataclasses import replace
from math import degrees, radians

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.leveling.floor_views import NO_DEPTH, Depth, floor_depth, make_view, mount
from vo_service.leveling.leveling import Leveling
from vo_service.types.level import LevelSource

MOUNT = mount(0.6)
UP = MOUNT[2, :3]
STEP_S = 0.1


def see(
    leveling: Leveling, T_odom_base: Array, depth_raw: Depth, seconds: float, start_s: float = 0.0
) -> Array:
    """Show one view for a while to a base at rest; return its pose in the corrected `odom`."""
    for n in range(round(seconds / STEP_S)):
        stamp_s = start_s + n * STEP_S
        T_odom_base = leveling.correct(T_odom_base, stamp_s) @ T_odom_base
        leveling.add_frame(make_view(depth_raw, stamp_s, UP), T_odom_base @ MOUNT)
    return T_odom_base


def start(leveling: Leveling, frame: RgbdFrame | None = None) -> Array:
    return leveling.start(make_view(floor_depth(UP, 0.6), up=UP) if frame is None else frame)


def test_the_floor_at_the_first_frame_corrects_the_accelerometer() -> None:
    leveling = Leveling(np.eye(4) @ mount(0.0))
    tilted = so3_exp([radians(1.0), 0.0, 0.0]) @ UP
    up = start(leveling, make_view(floor_depth(UP, 0.6), up=tilted))
    np.testing.assert_allclose(up, UP, atol=1e-3)
    assert leveling.level.source is LevelSource.FLOOR


def test_a_told_mount_finds_the_floor_without_an_accelerometer() -> None:
    leveling = Leveling(MOUNT)
    start(leveling, make_view(floor_depth(UP, 0.6)))
    assert leveling.level.source is LevelSource.FLOOR


def test_without_mount_and_accelerometer_the_first_pose_counts_as_level() -> None:
    leveling = Leveling(mount(0.0))
    start(leveling, make_view(floor_depth(UP, 0.6)))
    assert leveling.level.source is LevelSource.ASSUMED


@pytest.mark.parametrize("gravity_m_s2", [(0.0, 0.0, 0.0), (float("nan"), 9.8, 0.0)])
def test_what_cannot_be_gravity_levels_nothing(gravity_m_s2: tuple[float, float, float]) -> None:
    leveling = Leveling(mount(0.0))
    up = leveling.start(replace(make_view(NO_DEPTH), gravity_m_s2=gravity_m_s2))
    np.testing.assert_array_equal(up, mount(0.0)[2, :3])
    assert leveling.level.source is LevelSource.ASSUMED


@pytest.mark.parametrize("pitch_rad", [0.0, 1.2, np.pi])
def test_the_tilt_of_the_base_is_reported_at_any_attitude(pitch_rad: float) -> None:
    leveling = Leveling(MOUNT)
    R = (1.0 + 1e-12) * so3_exp([0.0, pitch_rad, 0.0])  # rounding errors of a long chain
    leveling.add_frame(make_view(NO_DEPTH), rigid_transform(R, np.zeros(3)) @ MOUNT)
    assert leveling.level.tilt_rad == pytest.approx(pitch_rad, abs=1e-6)


def test_drift_of_tilt_and_height_is_corrected_about_the_base() -> None:
    leveling = Leveling(MOUNT)
    start(leveling)
    see(leveling, np.eye(4), floor_depth(UP, 0.6), 2.0)
    drifted = rigid_transform(so3_exp([0.02, -0.01, 0.4]), (3.0, 2.0, 0.05))
    corrected = see(leveling, drifted, floor_depth(UP, 0.6), 20.0, start_s=2.0)
    assert degrees(np.arccos(corrected[2, 2])) < 0.05
    np.testing.assert_allclose(corrected[:3, 3], (3.0, 2.0, 0.0), atol=5e-3)
    assert leveling.level.camera_height_m == pytest.approx(0.6, abs=5e-3)
    assert 0.0 < leveling.level.sigma_rad < radians(0.5)


def test_a_single_view_of_another_plane_is_not_believed() -> None:
    leveling = Leveling(MOUNT)
    start(leveling)
    see(leveling, np.eye(4), floor_depth(UP, 0.6), 2.0)
    after = see(leveling, np.eye(4), floor_depth(UP, 0.3), 1.0, start_s=2.0)
    np.testing.assert_allclose(after, np.eye(4), atol=1e-4)
    assert leveling.level.camera_height_m == pytest.approx(0.6, abs=5e-3)


def test_another_floor_is_accepted_after_five_seconds_without_a_jump() -> None:
    leveling = Leveling(MOUNT)
    start(leveling)
    see(leveling, np.eye(4), floor_depth(UP, 0.6), 2.0)
    after = see(leveling, np.eye(4), floor_depth(UP, 0.3), 8.0, start_s=2.0)
    np.testing.assert_allclose(after, np.eye(4), atol=1e-3)
    assert leveling.level.camera_height_m == pytest.approx(0.3, abs=5e-3)


def test_the_accelerometer_carries_over_where_no_floor_is_in_view() -> None:
    leveling = Leveling(mount(0.0))
    start(leveling, make_view(NO_DEPTH, up=UP))
    tilted = rigid_transform(so3_exp([0.03, 0.0, 0.0]), np.zeros(3))
    for n in range(900):
        tilted = leveling.correct(tilted, n * STEP_S) @ tilted
        leveling.add_frame(make_view(NO_DEPTH, n * STEP_S, UP), tilted @ mount(0.0))
    assert leveling.level.source is LevelSource.ACCELEROMETER
    assert degrees(np.arccos(tilted[2, 2])) < 0.2


def test_a_planar_base_is_level_by_its_mount_where_no_floor_is_in_view() -> None:
    leveling = Leveling(MOUNT, is_planar=True)
    start(leveling, make_view(NO_DEPTH))
    drifted = rigid_transform(so3_exp([0.0, 0.02, 0.0]), (1.0, 0.0, 0.1))
    corrected = see(leveling, drifted, NO_DEPTH, 90.0)
    assert leveling.level.source is LevelSource.MOUNT
    assert degrees(np.arccos(corrected[2, 2])) < 0.05
    assert abs(corrected[2, 3]) < 0.01


def test_a_wrong_mount_of_a_planar_base_is_reported() -> None:
    leveling = Leveling(MOUNT, is_planar=True)
    start(leveling, make_view(floor_depth(UP, 0.9)))
    see(leveling, np.eye(4), floor_depth(UP, 0.9), 8.0)
    assert "0.60 m above the floor" in leveling.warning
    assert "is 0.90 m below it" in leveling.warning
    assert "kinect-vo doctor" in leveling.warning
