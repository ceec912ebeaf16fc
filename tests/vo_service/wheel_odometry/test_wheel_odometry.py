"""The motion of the base between two frames by its wheels."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import inverse
from tests.vo_service.wheel_odometry.wheel_driver import (
    CURVE,
    FRAME_S,
    START_S,
    ask,
    drive,
    pose_at,
    run,
    times,
    wheel_message,
    wheel_odometry,
)
from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist
from vo_service.wheel_odometry.wheel_odometry import NullWheelOdometry, WheelMotion, WheelOdometry

seconds = st.floats(0.1, 1.9)


def between(wheels: WheelOdometry, from_s: float, to_s: float) -> WheelMotion:
    motion = wheels.motion_between(START_S + from_s, START_S + to_s)
    assert motion is not None
    return motion


@given(seconds, seconds)
def test_the_motion_is_that_of_the_drive(one_s: float, other_s: float) -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 2.0, period_s=0.1))
    from_s, to_s = sorted((one_s, other_s))
    T = inverse(pose_at(from_s).transform()) @ pose_at(to_s).transform()
    # Stamps of today have a resolution of 0.2 us.
    assert between(wheels, from_s, to_s).T_from_to == pytest.approx(T, abs=1e-6)


@given(st.lists(seconds, min_size=3, max_size=3))
def test_motions_add_up(stamps_s: list[float]) -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 2.0, period_s=0.1))
    a, b, c = sorted(stamps_s)
    T = between(wheels, a, b).T_from_to @ between(wheels, b, c).T_from_to
    assert between(wheels, a, c).T_from_to == pytest.approx(T, abs=1e-9)


@given(st.floats(0.0, 0.05))
def test_the_twist_extrapolates(age_s: float) -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.8, 1.001))
    T = inverse(pose_at(0.9).transform()) @ pose_at(1.0 + age_s).transform()
    assert between(wheels, 0.9, 1.0 + age_s).T_from_to == pytest.approx(T, abs=1e-6)


@pytest.mark.parametrize("unit", [0.0, 57.3, 1000.0])
def test_a_twist_that_contradicts_the_poses_is_not_used(unit: float) -> None:
    wheels = wheel_odometry()
    for time_s in times(0.0, 1.001):
        twist = PlanarTwist(*(unit * value for value in CURVE))
        wheels.add_message(wheel_message(START_S + time_s, pose_at(time_s), twist))
    T = inverse(pose_at(0.9).transform()) @ pose_at(1.04).transform()
    assert between(wheels, 0.9, 1.04).T_from_to == pytest.approx(T, abs=1e-6)


def test_beyond_50_ms_the_pose_stays_and_its_sigmas_grow() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 1.001))
    known, old = between(wheels, 0.9, 1.05), between(wheels, 0.9, 1.15)
    assert old.T_from_to == pytest.approx(known.T_from_to, abs=1e-6)
    assert old.sigmas[0] - known.sigmas[0] == pytest.approx(0.3 * 0.1, rel=0.1)
    assert old.sigmas[5] - known.sigmas[5] == pytest.approx(0.5 * 0.1, rel=0.1)


def test_there_is_no_motion_outside_of_the_poses() -> None:
    wheels = wheel_odometry()
    assert ask(wheels, 0.0) is None
    drive(wheels, times(0.5, 1.001))
    assert wheels.motion_between(START_S + 0.49, START_S + 0.8) is None
    assert wheels.motion_between(START_S + 0.9, START_S + 1.21) is None
    assert wheels.motion_between(START_S + 0.8, START_S + 0.7) is None
    assert wheels.motion_between(START_S + 0.5, START_S + 1.19) is not None


def test_a_time_in_a_long_gap_is_not_covered_but_a_gap_inside_is() -> None:
    wheels = wheel_odometry(max_age_s=0.1)
    drive(wheels, [*times(0.0, 0.5), *times(1.0, 1.5)])
    assert wheels.motion_between(START_S + 0.4, START_S + 0.7) is None
    T = inverse(pose_at(0.4).transform()) @ pose_at(1.1).transform()
    assert between(wheels, 0.4, 1.1).T_from_to == pytest.approx(T, abs=1e-6)


def test_sigmas_are_shares_of_the_path() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 1.0))
    path_m, turn_rad = 0.3 * FRAME_S, 0.5 * FRAME_S
    expected_yaw = 0.05 * turn_rad + 0.001
    expected = [
        0.05 * path_m + 0.0005,
        0.02 * path_m + 0.0005 + 0.5 * path_m * expected_yaw,
        0.002,
        np.radians(0.2),
        np.radians(0.2),
        expected_yaw,
    ]
    assert between(wheels, 0.5, 0.5 + FRAME_S).sigmas == pytest.approx(expected, rel=1e-3)


def test_a_full_turn_is_uncertain_though_its_motion_is_small() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 7.0), PlanarTwist(0.0, 0.0, 1.0))
    motion = between(wheels, 0.1, 0.1 + 2 * np.pi)
    assert motion.T_from_to == pytest.approx(np.eye(4), abs=1e-5)
    assert motion.sigmas[5] > 0.3


@pytest.mark.parametrize("variance", [0.0, 1e-9, 1e6])
def test_a_variance_that_no_driver_knows_is_not_used(variance: float) -> None:
    wheels, usual = wheel_odometry(), wheel_odometry()
    drive(wheels, times(0.0, 1.0), variances=(variance, variance, variance))
    drive(usual, times(0.0, 1.0))
    assert between(wheels, 0.3, 0.4).sigmas.tolist() == between(usual, 0.3, 0.4).sigmas.tolist()


def test_the_driver_tells_the_variance_of_its_twist() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 1.0), variances=(0.04, None, 0.01))
    sigmas = between(wheels, 0.5, 0.6).sigmas
    assert sigmas[0] == pytest.approx(0.2 * 0.1 + 0.0005)
    assert sigmas[5] == pytest.approx(0.1 * 0.1 + 0.001)


def test_ten_seconds_are_kept() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 12.0, period_s=0.1))
    assert wheels.motion_between(START_S + 1.0, START_S + 11.9) is None
    assert wheels.motion_between(START_S + 2.5, START_S + 11.9) is not None


def test_messages_come_on_another_thread() -> None:
    wheels = wheel_odometry()
    sender = threading.Thread(target=drive, args=(wheels, times(0.0, 4.0, period_s=0.005)))
    sender.start()
    while sender.is_alive():
        ask(wheels, 2.0)
    sender.join()
    assert ask(wheels, 2.0) is not None


def test_a_drive_has_a_motion_at_each_frame_and_no_warning() -> None:
    wheels = wheel_odometry()
    motions = run(wheels, 0.0, 3.0)
    assert None not in motions[3:]
    assert wheels.warning == ""


def test_without_wheels_there_is_no_motion() -> None:
    null = NullWheelOdometry()
    null.add_visual_motion(0.0, 1.0, np.eye(4), np.eye(6), is_well_constrained=True)
    assert null.motion_between(0.0, 1.0) is None
    assert null.warning == ""


def test_the_pose_of_the_wheels_may_lie_anywhere() -> None:
    near, far = wheel_odometry(), wheel_odometry()
    for time_s in times(0.0, 0.5):
        pose = CURVE.motion(time_s)
        near.add_message(wheel_message(START_S + time_s, pose, CURVE))
        moved = PlanarPose(-40.0, 7.0, -3.0).then(pose)
        far.add_message(wheel_message(START_S + time_s, moved, CURVE))
    T = between(near, 0.2, 0.3).T_from_to
    assert between(far, 0.2, 0.3).T_from_to == pytest.approx(T, abs=1e-9)
