"""Messages of the wheels over real Zenoh, on the session of the poses."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest
import zenoh

from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import PoseSubscriber, config, connected_session
from tests.waiting import wait_until
from vo_service.outputs.zenoh.base_subscription import (
    MAX_MESSAGE_BYTES,
    BaseSubscription,
)
from vo_service.outputs.zenoh.output import LIVE_QOS, ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints

pytestmark = pytest.mark.zenoh

KEY = "kinect/wheel_odom"


@contextmanager
def output_with_wheels(
    port: int, on_message: Callable[[bytes], None]
) -> Iterator[tuple[ZenohOutput, zenoh.Session]]:
    """Run an output that subscribes to wheels; yield it and a session that sends."""
    wheels = BaseSubscription(KEY, on_message)
    extras = ExtraEndpoints(subscriptions=(wheels.declare,))
    with (
        closing(ZenohOutput(config(port), LIVE_QOS, extra_endpoints=extras)) as output,
        connected_session(port) as session,
    ):
        yield output, session


def wait_for_subscription(session: zenoh.Session) -> None:
    publisher = session.declare_publisher(KEY)
    wait_until(lambda: publisher.matching_status.matching)  # type: ignore[attr-defined]


def test_messages_are_received_in_order(free_port: int) -> None:
    received: list[bytes] = []
    with output_with_wheels(free_port, received.append) as (_, session):
        wait_for_subscription(session)
        for number in range(10):
            session.put(KEY, b"%d" % number)
            wait_until(lambda: len(received) > number)  # noqa: B023 (called at once)
    assert received == [b"%d" % number for number in range(10)]


def test_a_message_that_is_far_too_long_is_not_handed_over(free_port: int) -> None:
    received: list[bytes] = []
    with output_with_wheels(free_port, received.append) as (_, session):
        wait_for_subscription(session)
        # Without blocking, Zenoh may drop a message behind a long one.
        for payload in (bytes(MAX_MESSAGE_BYTES + 1), b"short"):
            session.put(KEY, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        wait_until(lambda: bool(received))
    assert received == [b"short"]


def test_a_flood_delays_no_pose_and_the_newest_message_arrives(free_port: int) -> None:
    received: list[bytes] = []
    with output_with_wheels(free_port, received.append) as (output, session):
        wait_for_subscription(session)
        poses = PoseSubscriber(session, output)
        for number in range(5000):
            session.put(KEY, b"%d" % number)
        assert poses.receives_all([make_update(seq) for seq in range(20)])
        wait_until(lambda: b"4999" in received)
    assert len(received) < 5000
