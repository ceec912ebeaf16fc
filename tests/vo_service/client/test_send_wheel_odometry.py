"""What a base sends with the client is what the service reads."""

import math
from typing import Any

import pytest

from drivers.core import InputError
from tests.vo_service.client.fake_service import find_free_endpoint, running_fake_service
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.wheel_odometry.wheel_reading import WheelReading, parse_wheel_reading

pytestmark = pytest.mark.zenoh

STAMP_S = 1_700_000_000.25


def test_the_service_reads_what_a_base_sends() -> None:
    received: list[WheelReading] = []
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as service, PoseClient(connect=endpoint) as client:
        service.session.declare_subscriber(
            "kinect/wheel_odom",
            lambda sample: received.append(parse_wheel_reading(sample.payload.to_bytes())),
        )

        def has_received() -> bool:
            client.send_wheel_odometry(STAMP_S, 1.0, 2.0, -3.0, (0.3, 0.1, 0.5), (0.01, None, 0.02))
            return bool(received)

        wait_until(has_received)
    reading = received[0]
    assert reading.stamp_s == STAMP_S
    assert reading.frame_ids == ("wheel_odom", "base_link")
    assert reading.pose == pytest.approx((1.0, 2.0, -3.0))
    assert reading.twist == (0.3, 0.1, 0.5)
    assert reading.twist_variances == (0.01, None, 0.02)


def test_without_a_service_a_pose_is_lost() -> None:
    with PoseClient(connect=find_free_endpoint()) as client:
        client.send_wheel_odometry(STAMP_S, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, "left"])
@pytest.mark.parametrize("argument", range(4))
def test_a_pose_that_is_no_number_is_not_sent(argument: int, wrong: Any) -> None:
    arguments: Any = [STAMP_S, 0.0, 0.0, 0.0]
    arguments[argument] = wrong
    with (
        PoseClient(connect=find_free_endpoint()) as client,
        pytest.raises(InputError, match="is not a finite number"),
    ):
        client.send_wheel_odometry(*arguments)
