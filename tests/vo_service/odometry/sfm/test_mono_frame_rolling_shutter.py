"""Compensation of a rolling shutter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from drivers.camera import RgbdFrame
from drivers.core.geometry import (
    Array,
    inverse,
    rigid_transform,
    rotation_angle_rad,
    so3_exp,
    transform_points,
)
from tests.vo_service.odometry.hand_held_sequence import estimate_all
from tests.vo_service.odometry.sfm.ray_pairs import small_vectors
from tests.vo_service.odometry.sfm.sideways_sequence import render_view
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.sfm.mono_frame import MonoFrame, ShutterMotion
from vo_service.odometry.sfm.odometry import SfmOdometry
from vo_service.types.estimate import Estimate

DEPTH_M = 2.0
STRIP = 40  # rows of one instant: what a shutter that rolls does, roughly
READOUT_S = 1.0 / 30.0
TURNS_BACK = 6.5


def going(frames: float) -> Array:
    """A fast motion that reverses half way, which reverses the distortion."""
    frames = TURNS_BACK - abs(frames - TURNS_BACK)
    turn = so3_exp(frames * np.array([0.01, -0.02, 0.004]))
    return rigid_transform(turn, frames * np.array([0.045, 0.0, 0.01]))


def rolled(k: int) -> RgbdFrame:
    """The k-th frame, strip by strip."""
    whole = render_corner(going(k), k)
    color, depth = whole.color_bgr.copy(), whole.depth_raw.copy()
    for top in range(0, len(color), STRIP):
        delay_s = READOUT_S * ((top + STRIP / 2) / len(color) - 0.5)
        at_once = render_corner(going(k + 30.0 * delay_s), k)
        rows = slice(top, top + STRIP)
        color[rows], depth[rows] = at_once.color_bgr[rows], at_once.depth_raw[rows]
    return replace(whole, color_bgr=color, depth_raw=depth, readout_s=READOUT_S)


@given(small_vectors(2.0), small_vectors(1.0))
def test_rays_are_transformed_to_the_time_of_the_frame(
    turn_rad_s: Array, velocity_m_s: Array
) -> None:
    points = DEPTH_M * np.array([[-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], [0.1, 0.3, 1.0]])
    delay_s = np.array([-0.01, 0.01, 0.005])
    seen = []
    for P, dt in zip(points, delay_s, strict=True):
        T_now_then = rigid_transform(so3_exp(turn_rad_s * dt), velocity_m_s * dt)
        P_then = transform_points(inverse(T_now_then), P[None])[0]
        seen.append(P_then / P_then[2])
    sweep = ShutterMotion(velocity_m_s / DEPTH_M, turn_rad_s)
    np.testing.assert_allclose(
        sweep.undistort_rays(np.array(seen), delay_s)[:, :2], points[:, :2] / DEPTH_M, atol=4e-4
    )


def test_the_shutter_motion_is_the_velocity_over_the_distance() -> None:
    T = rigid_transform(so3_exp([0.0, 0.02, 0.0]), [0.03, 0.0, 0.0])
    sweep = ShutterMotion.from_motion(T, 0.1, 1.0 / DEPTH_M)
    np.testing.assert_allclose(sweep.translation_per_s, [0.15, 0.0, 0.0], atol=0.004)
    np.testing.assert_allclose(sweep.angular_velocity_rad_s, [0.0, 0.2, 0.0])


def test_a_motion_backwards_in_time_has_the_same_velocity() -> None:
    T = rigid_transform(so3_exp([0.01, 0.02, 0.0]), [0.03, 0.0, 0.01])
    begin, end = (
        ShutterMotion.from_motion(inverse(T), -0.1, 0.5),
        ShutterMotion.from_motion(T, 0.1, 0.5),
    )
    np.testing.assert_allclose(begin.angular_velocity_rad_s, end.angular_velocity_rad_s)
    np.testing.assert_allclose(
        begin.translation_per_s, T[:3, :3] @ end.translation_per_s, atol=1e-12
    )


def test_a_motion_without_duration_has_no_velocity() -> None:
    sweep = ShutterMotion.from_motion(rigid_transform(np.eye(3), [1.0, 0.0, 0.0]), 0.0, 0.5)
    assert not sweep.translation_per_s.any()
    assert not sweep.angular_velocity_rad_s.any()


def test_a_global_shutter_is_not_compensated() -> None:
    still = MonoFrame.from_features(SurfExtractor(50).extract(render_view(0).gray), render_view(0))
    assert not still.has_rolling_shutter
    assert still.compensate_rolling_shutter(ShutterMotion(np.ones(3), np.ones(3))) is still


def step_error_deg(estimates: list[Estimate]) -> float:
    """How far the turn over the last three frames is off."""
    T = inverse(estimates[6].T_world_camera) @ estimates[9].T_world_camera
    error = inverse(T) @ inverse(going(6)) @ going(9)
    return float(np.degrees(rotation_angle_rad(error[:3, :3])))


@pytest.mark.slow
def test_a_known_rolling_shutter_costs_little() -> None:
    frames = [rolled(k) for k in range(10)]
    error_with_timing_deg = step_error_deg(estimate_all(SfmOdometry(), frames))
    error_without_timing_deg = step_error_deg(
        estimate_all(SfmOdometry(), [replace(f, readout_s=0.0) for f in frames])
    )
    assert error_with_timing_deg < 0.2 * error_without_timing_deg
