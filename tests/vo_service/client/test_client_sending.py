"""What a base or a program sends with the client is what the service reads."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.ros_messages.decoding import decode_twist
from tests.vo_service.client.fake_service import find_free_endpoint, running_fake_service
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.wheel_odometry.wheel_reading import parse_wheel_reading

pytestmark = pytest.mark.zenoh

STAMP_S = 1_700_000_000.25


def payload_of(key: str, send: Callable[[PoseClient], None]) -> bytes:
    """Return what a service receives under this key."""
    received: list[bytes] = []
    with running_fake_service() as service, PoseClient(connect=service.endpoint) as client:
        service.session.declare_subscriber(
            key, lambda sample: received.append(sample.payload.to_bytes())
        )

        def has_received() -> bool:
            send(client)
            return bool(received)

        wait_until(has_received)
    return received[0]


def test_the_service_reads_the_velocity() -> None:
    payload = payload_of("kinect/cmd_vel", lambda client: client.send_velocity(0.3, -0.5))
    np.testing.assert_array_equal(decode_twist(payload), [0.3, 0.0, 0.0, 0.0, 0.0, -0.5])


def test_the_service_reads_the_odometry_of_the_wheels() -> None:
    arguments: Any = STAMP_S, 1.0, 2.0, -3.0, (0.3, 0.1, 0.5), (0.01, None, 0.02)
    reading = parse_wheel_reading(
        payload_of("kinect/wheel_odom", lambda client: client.send_wheel_odometry(*arguments))
    )
    assert reading.stamp_s == STAMP_S
    assert reading.frame_ids == ("wheel_odom", "base_link")
    assert reading.pose == pytest.approx((1.0, 2.0, -3.0))
    assert reading.twist == (0.3, 0.1, 0.5)
    assert reading.twist_variances == (0.01, None, 0.02)


def test_without_a_service_a_message_is_lost() -> None:
    with PoseClient(connect=find_free_endpoint()) as client:
        client.send_velocity(0.1, 0.0)
        client.send_wheel_odometry(STAMP_S, 0.0, 0.0, 0.0)
