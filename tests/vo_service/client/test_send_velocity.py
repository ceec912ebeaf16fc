"""What a program sends with the client is what the service drives by."""

import math

import pytest

from drivers.core import InputError
from drivers.ros_messages.decoding import decode_twist
from tests.vo_service.client.fake_service import find_free_endpoint, running_fake_service
from tests.waiting import wait_until
from vo_service import PoseClient

pytestmark = pytest.mark.zenoh


def test_the_service_reads_the_velocity() -> None:
    received: list[list[float]] = []
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as service, PoseClient(connect=endpoint) as client:
        service.session.declare_subscriber(
            "kinect/cmd_vel",
            lambda sample: received.append(decode_twist(sample.payload.to_bytes()).tolist()),
        )

        def has_received() -> bool:
            client.send_velocity(0.3, -0.5)
            return bool(received)

        wait_until(has_received)
    assert received[0] == [0.3, 0.0, 0.0, 0.0, 0.0, -0.5]


def test_a_velocity_that_is_no_number_is_not_sent() -> None:
    with PoseClient(connect=find_free_endpoint()) as client:
        client.send_velocity(0.1, 0.0)  # nobody is there: it is lost
        for wrong in (math.nan, "fast", None):
            with pytest.raises(InputError, match="is not a finite number"):
                client.send_velocity(wrong, 0.0)  # type: ignore[arg-type]
