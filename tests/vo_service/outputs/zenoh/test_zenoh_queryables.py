"""Queries for the last pose, the last status and the schemas."""

import threading
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
import zenoh

from drivers.ros_messages.decoding import decode_odometry
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.outputs.zenoh.query_helpers import (
    PoseSubscriber,
    config,
    connected_session,
    queried_seq,
    query,
    query_json,
    reply_json,
)
from tests.waiting import wait_until
from vo_service.outputs.zenoh.output import ZenohOutput

pytestmark = pytest.mark.zenoh


@pytest.fixture
def output(free_port: int) -> Iterator[ZenohOutput]:
    with closing(ZenohOutput(config(free_port))) as opened:
        yield opened


@pytest.fixture
def session(output: ZenohOutput, free_port: int) -> Iterator[zenoh.Session]:
    """A session that is connected to the output."""
    with connected_session(free_port) as opened:
        yield opened


def test_before_the_first_pose_a_query_returns_an_error(session: zenoh.Session) -> None:
    (pose,) = query_json(session, "kinect/latest")
    (status,) = query_json(session, "kinect/status")
    assert pose == {"schema": 1, "error": "not-possible", "message": "there is no pose yet"}
    assert status["message"] == "there is no status yet"


def test_the_last_pose_is_the_published_message(
    output: ZenohOutput, session: zenoh.Session
) -> None:
    output.on_update(make_update(6))
    output.on_update(make_update(7))
    wait_until(lambda: queried_seq(session, "kinect/latest") == 7)
    (reply,) = query(session, "kinect/latest")
    assert reply.ok is not None
    message = decode_odometry(reply.ok.payload.to_bytes())
    assert str(reply.ok.encoding) == "application/cdr;nav_msgs/msg/Odometry"
    np.testing.assert_allclose(message.T_frame_child, make_update(7).T_odom_base)


def test_the_last_status_is_the_published_one(output: ZenohOutput, session: zenoh.Session) -> None:
    output.on_status(STATUS)
    wait_until(lambda: "error" not in query_json(session, "kinect/status")[0])
    (answer,) = query_json(session, "kinect/status")
    assert (answer["schema"], answer["state"], answer["latency"]["fps"]) == (1, "degraded", 29.9)


def test_a_wildcard_query_gets_each_reply_under_its_own_key(
    output: ZenohOutput, session: zenoh.Session
) -> None:
    output.on_status(STATUS)
    output.on_update(make_update(0))
    wait_until(lambda: queried_seq(session, "kinect/latest") == 0)
    keys = {str(reply.ok.key_expr) for reply in query(session, "kinect/**") if reply.ok}
    assert keys == {"kinect/latest", "kinect/status", "kinect/schema"}


def test_a_flood_of_queries_does_not_affect_poses_and_later_replies(
    output: ZenohOutput, session: zenoh.Session
) -> None:
    poses = PoseSubscriber(session, output)
    flood = [session.get("kinect/latest", timeout=100) for _ in range(3000)]
    assert poses.receives_all([make_update(seq) for seq in range(20)])
    replies = [reply for channel in flood for reply in channel]
    wait_until(lambda: queried_seq(session, "kinect/latest") == 19)
    assert 0 < len(replies) < 3000


def test_a_query_that_fails_inside_gets_an_error_reply(
    output: ZenohOutput, session: zenoh.Session
) -> None:
    output._latest["latest"] = lambda: (b"", 5)  # type: ignore[assignment, return-value]
    (reply,) = query(session, "kinect/latest")
    assert reply_json(reply)["error"] == "failed"
    assert query_json(session, "kinect/schema")


def test_closing_leaves_no_thread(free_port: int) -> None:
    before = threading.active_count()
    for _ in range(3):
        ZenohOutput(config(free_port)).close()
        assert threading.active_count() == before
