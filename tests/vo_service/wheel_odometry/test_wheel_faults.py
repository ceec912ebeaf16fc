"""Faults of the wheels and their driver: one warning each, no exception, no wrong motion."""

import logging

import numpy as np
import pytest

from drivers.ros_messages.cdr import CdrWriter, encode_string
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
from vo_service.wheel_odometry.wheel_odometry import WheelOdometry


def raw_message(*numbers: float) -> bytes:
    """A message with the numbers of the pose, as no encoder of ours writes it."""
    writer = CdrWriter()
    writer.header(START_S + 1.0, "wheel_odom")
    writer.string("base_link")
    writer.float64s(np.array([*numbers, *np.zeros(85 - len(numbers))]))
    return writer.to_bytes()


@pytest.mark.parametrize(
    ("payload", "cause"),
    [
        (b"", "not little-endian CDR"),
        (b"\x00\x01\x00\x00", "not a nav_msgs/msg/Odometry message: it ends"),
        (encode_string("x" * 2000), "not a nav_msgs/msg/Odometry message"),
        (raw_message(np.nan, 0, 0, 0, 0, 0, 1), "not finite"),
        (raw_message(0, 0, 0, 0, 0, 0, 1, *np.zeros(36), np.inf), "not finite"),
        (raw_message(0, 0, 0, np.nan, 0, 0, 1), "its quaternion has length nan, not 1"),
        (raw_message(0, 0, 0, 0, 0, 0, 0), "its quaternion has length 0, not 1"),
        (raw_message(0, 0, 0, 0, 0, 0, 0.5), "its quaternion has length 0.5, not 1"),
        (raw_message(1e9, 0, 0, 0, 0, 0, 1), "positions are in meters"),
    ],
)
def test_a_message_that_is_no_pose_is_not_used(payload: bytes, cause: str) -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    before = ask(wheels, 1.0)
    wheels.add_message(payload)
    after = ask(wheels, 1.0)
    assert before is not None
    assert after is not None
    assert np.array_equal(before.T_from_to, after.T_from_to)
    assert wheels.warning.startswith("wheel odometry: a message on kinect/wheel_odom is not used")
    assert cause in wheels.warning
    run(wheels, 1.0, 2.1)
    assert wheels.warning == ""


def test_a_negative_stamp_is_no_time() -> None:
    wheels = wheel_odometry()
    wheels.add_message(wheel_message(-0.5, PlanarPose(0, 0, 0), CURVE))
    assert "its stamp is -0.5 s, before 1970" in wheels.warning


def test_a_jump_restarts_the_history() -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    wheels.add_message(wheel_message(START_S + 1.0, PlanarPose(0, 0, 0), CURVE))
    assert ask(wheels, 1.01) is None
    assert "the pose jumped by 3.33 m and 171 deg" in wheels.warning
    for time_s in times(1.02, 1.1):
        wheels.add_message(wheel_message(START_S + time_s, CURVE.motion(time_s - 1.0), CURVE))
    motion = ask(wheels, 1.08)
    assert motion is not None
    assert motion.T_from_to[:2, 3] == pytest.approx([0.3 * FRAME_S, 0.0], abs=1e-3)


def test_a_turn_that_no_base_makes_is_a_jump() -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    turned = pose_at(1.0).then(PlanarPose(0.0, 0.0, 1.0))
    wheels.add_message(wheel_message(START_S + 1.0, turned, CURVE))
    assert ask(wheels, 1.01) is None
    assert "58 deg" in wheels.warning


def test_a_driver_that_never_comes() -> None:
    wheels = wheel_odometry()
    for frame_s in times(0.0, 1.0, FRAME_S):
        assert ask(wheels, frame_s) is None
    assert wheels.warning == "wheel odometry: no message on kinect/wheel_odom"


def test_a_driver_that_ends() -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    motions = [ask(wheels, frame_s) for frame_s in times(1.0, 2.0, FRAME_S)]
    assert motions[-1] is None
    assert "no message on kinect/wheel_odom for 1.0" in wheels.warning
    run(wheels, 2.0, 2.5)
    assert wheels.warning == ""


def test_a_driver_whose_stamps_stop() -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    for frame_s in times(1.0, 2.0, FRAME_S):
        drive(wheels, [0.98])
        motion = ask(wheels, frame_s)
    assert motion is None
    assert "the stamps on kinect/wheel_odom stand still" in wheels.warning


@pytest.mark.parametrize(("offset_s", "side"), [(0.8, "ahead"), (20.0, "ahead"), (-0.3, "old")])
def test_clocks_that_are_not_synchronized(offset_s: float, side: str) -> None:
    wheels = wheel_odometry()
    motions = run(wheels, 0.0, 3.0, offset_s=offset_s)
    assert f"s {side}: synchronize the clocks" in wheels.warning
    assert not any(motions[45:])


def test_a_small_offset_of_the_clocks_is_allowed() -> None:
    wheels = wheel_odometry()
    motions = run(wheels, 0.0, 3.0, offset_s=-0.1)
    assert wheels.warning == ""
    assert None not in motions[10:]


def test_one_stamp_of_the_future_costs_a_moment() -> None:
    wheels = wheel_odometry()
    run(wheels, 0.0, 1.0)
    drive(wheels, [1.0], offset_s=100.0)
    motions = run(wheels, 1.0, 1.5)
    assert "its clock was set back by 99.9" in wheels.warning
    assert None not in motions[10:]


def test_a_clock_that_is_set_back_restarts_the_history() -> None:
    wheels = wheel_odometry()
    run(wheels, 10.0, 11.0)
    motions = run(wheels, 0.0, 0.5)
    assert "its clock was set back by 10" in wheels.warning
    assert motions[-1] is not None


def test_messages_out_of_order_or_sent_twice_are_ignored() -> None:
    wheels, ordered = wheel_odometry(), wheel_odometry()
    drive(wheels, [0.0, 0.02, 0.02, 0.06, 0.04, 0.08, 0.1])
    drive(ordered, [0.0, 0.02, 0.06, 0.08, 0.1])
    one, other = ask(wheels, 0.09), ask(ordered, 0.09)
    assert one is not None
    assert other is not None
    assert np.array_equal(one.T_from_to, other.T_from_to)
    assert wheels.warning == ""


def test_a_fault_is_logged_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    wheels = wheel_odometry()
    with caplog.at_level(logging.WARNING):
        for frame_s in times(0.0, 3.0, FRAME_S):
            wheels.add_message(b"no message")
            ask(wheels, frame_s)
    assert [record.message[:40] for record in caplog.records] == [
        "wheel odometry: a message on kinect/whee"
    ]


CERTAIN = np.diag(np.full(6, 1e-8))


def see(wheels: WheelOdometry, frame_s: float, seen: PlanarTwist, *, is_good: bool = True) -> None:
    T = seen.motion(FRAME_S).transform()
    stamp_s = START_S + frame_s
    wheels.add_visual_motion(stamp_s - FRAME_S, stamp_s, T, CERTAIN, is_well_constrained=is_good)


def test_wheels_that_slip_count_less_for_a_second() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 4.0))
    usual = ask(wheels, 0.5)
    for frame_s in (0.6, 0.63, 0.66):
        see(wheels, frame_s, PlanarTwist(0.1, 0.0, 0.5))
    slipping, later = ask(wheels, 0.7), ask(wheels, 1.7)
    assert usual is not None
    assert slipping is not None
    assert later is not None
    factors = slipping.sigmas / usual.sigmas
    assert factors == pytest.approx([10, 10, 1, 1, 1, 10], rel=1e-3)
    assert later.sigmas == pytest.approx(usual.sigmas, rel=1e-3)


def test_a_slip_is_a_warning() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 4.0))
    for frame_s in (0.6, 0.63, 0.66):
        see(wheels, frame_s, PlanarTwist(0.0, 0.0, 0.5))
    assert wheels.warning == (
        "wheel odometry: the wheels slip: they tell 10 mm and 1.0 deg from a frame to the next, "
        "the camera 0 mm and 1.0 deg"
    )


@pytest.mark.parametrize("frames", [2, 0])
def test_two_frames_or_poor_views_tell_nothing_of_slip(frames: int) -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 4.0))
    for number in range(10):
        is_good = number < frames
        see(wheels, 0.6 + 0.03 * number, PlanarTwist(0.0, 0.0, 0.0), is_good=is_good)
    assert wheels.warning == ""


def test_wheels_that_agree_with_the_camera_do_not_slip() -> None:
    wheels = wheel_odometry()
    drive(wheels, times(0.0, 4.0))
    for number in range(10):
        see(wheels, 0.6 + 0.03 * number, PlanarTwist(0.29, 0.0, 0.51))
    assert wheels.warning == ""
