"""The odometry of wheels that is read from a recording, frame by frame."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest

from drivers.core import InputError
from tests.vo_service.wheel_odometry.wheel_driver import (
    CURVE,
    FRAME_S,
    START_S,
    ask,
    drive,
    pose_at,
    times,
    wheel_message,
    wheel_odometry,
)
from vo_service.config_tables import WheelOdometryConfig
from vo_service.wheel_odometry.recorded_wheels import RecordedWheelOdometry, recorded_topics


def messages(times_s: list[float]) -> list[bytes]:
    return [wheel_message(START_S + each, pose_at(each), CURVE) for each in times_s]


def recorded(payloads: list[bytes]) -> RecordedWheelOdometry:
    return RecordedWheelOdometry(WheelOdometryConfig(True), "/wheel_odom", partial(iter, payloads))


def test_each_motion_is_between_poses_on_both_sides() -> None:
    wheels, complete = recorded(messages(times(0.0, 3.0))), wheel_odometry()
    drive(complete, times(0.0, 3.0))
    for frame_s in times(0.1, 2.9, FRAME_S):
        motion, expected = ask(wheels, frame_s), ask(complete, frame_s)
        assert motion is not None
        assert expected is not None
        assert np.array_equal(motion.T_from_to, expected.T_from_to)
        assert np.array_equal(motion.sigmas, expected.sigmas)
    assert wheels.warning == ""


def test_no_message_is_read_before_its_time() -> None:
    wheels = recorded(messages(times(0.0, 1.0, period_s=0.1)))
    journal = wheels.open_journal()
    ask(wheels, 0.25)
    assert [round(message.stamp_s - START_S, 3) for message in journal.take()] == [0, 0.1, 0.2, 0.3]
    ask(wheels, 0.28)
    assert journal.take() == []


def test_the_end_of_the_wheels_is_a_warning() -> None:
    wheels = recorded(messages(times(0.0, 1.0)))
    motions = [ask(wheels, frame_s) for frame_s in times(0.1, 2.0, FRAME_S)]
    assert motions[-1] is None
    assert "no message on /wheel_odom for " in wheels.warning


def test_a_recording_without_wheels_is_a_warning() -> None:
    wheels = recorded([])
    for frame_s in times(0.0, 1.0, FRAME_S):
        assert ask(wheels, frame_s) is None
    assert wheels.warning == "wheel odometry: no message on /wheel_odom"


def test_a_clock_that_was_set_back_in_the_recording_is_followed() -> None:
    wheels = recorded(messages([*times(10.0, 11.0), *times(0.0, 1.0)]))
    for frame_s in times(10.1, 10.9, FRAME_S):
        assert ask(wheels, frame_s) is not None
    motions = [ask(wheels, frame_s) for frame_s in times(0.2, 0.9, FRAME_S)]
    assert None not in motions[1:]


def test_a_damaged_rest_is_a_warning_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    def read() -> Iterator[bytes]:
        yield from messages(times(0.0, 1.0))
        raise InputError("desk.mcap: cannot be read")

    wheels = RecordedWheelOdometry(WheelOdometryConfig(True), "/wheel_odom", read)
    motions = [ask(wheels, frame_s) for frame_s in times(0.1, 1.5, FRAME_S)]
    assert motions[0] is not None
    assert motions[-1] is None
    assert "wheel odometry: desk.mcap: cannot be read" in caplog.messages


def test_the_topic_of_the_configuration_is_read_too() -> None:
    assert recorded_topics(WheelOdometryConfig(True)) == ("/wheel_odom",)
    topics = recorded_topics(WheelOdometryConfig(True, "robot/odom"))
    assert topics == ("/wheel_odom", "/robot/odom")
