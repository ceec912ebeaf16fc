"""The benchmarks of a robot's base: what they simulate."""

import numpy as np
import pytest

from benchmarks.base import SimulatedWheels, TrueMotion, Variant
from benchmarks.leveling import simulate
from drivers.core.geometry import Trajectory, rigid_transform, so3_exp
from vo_service.wheel_odometry.planar_pose import planar_part

STAMPS_S = 1000.0 + np.arange(0.0, 10.0, 0.1)


def straight_drive() -> TrueMotion:
    """At 0.3 m/s along x, with a turn of 0.1 rad/s."""
    poses = [
        rigid_transform(so3_exp([0.0, 0.0, 0.1 * t]), (0.3 * t, 0.0, 0.0))
        for t in STAMPS_S - STAMPS_S[0]
    ]
    return TrueMotion(Trajectory(STAMPS_S, np.array(poses)), np.eye(4))


def test_true_motion_is_known_between_stamps() -> None:
    motion = straight_drive()
    halves = motion.between(1001.0, 1001.05) @ motion.between(1001.05, 1001.1)
    np.testing.assert_allclose(halves, motion.between(1001.0, 1001.1), atol=1e-12)


@pytest.mark.parametrize("slip", [0.0, 0.4])
def test_wheels_tell_the_motion_with_their_errors(slip: float) -> None:
    true, wheels = straight_drive(), SimulatedWheels(straight_drive(), Variant(slip=slip))
    told = wheels.motion_between(1005.1, 1005.3)
    assert told is not None
    expected = planar_part(true.between(1005.1, 1005.3))
    found = planar_part(told.T_from_to)
    assert found.x_m / expected.x_m == pytest.approx(1.02 * (1.0 + slip), abs=0.02)
    assert found.yaw_rad / expected.yaw_rad == pytest.approx(1.03, abs=0.1)


def test_a_minute_of_driving_with_the_floor_in_view_stays_level() -> None:
    tilt_rms_deg, _, height_m, step_deg, step_m, _ = simulate(0.02, True, 0.5, 0)
    assert 0.0 < tilt_rms_deg < 0.2
    assert height_m < 0.05
    assert step_deg < 0.03
    assert step_m < 1e-3


def test_the_drift_is_that_of_the_odometry() -> None:
    drifting, _, _, _, _, _ = simulate(0.5, False, 0.5, 0)
    steady, _, _, _, _, _ = simulate(0.02, False, 0.5, 0)
    assert drifting > 1.5 * steady
