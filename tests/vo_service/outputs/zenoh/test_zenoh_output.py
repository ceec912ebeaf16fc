"""Poses over real Zenoh, to a process that uses nothing of this project."""

import dataclasses
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.outputs.zenoh.query_helpers import attachment_of, config, connected_session
from vo_service.outputs.zenoh.output import LIVE_QOS, LOCKSTEP_QOS, ZenohOutput
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh

READER = Path(__file__).with_name("plain_zenoh_reader.py")
ROS = get_typestore(Stores.ROS2_JAZZY)


@contextmanager
def reader(port: int, count: int, seconds_per_sample: float) -> Iterator[subprocess.Popen[str]]:
    """Run the plain subscriber in a process; leaving the block waits for its output."""
    command = [sys.executable, str(READER), str(port), str(count), str(seconds_per_sample)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process


def read_with_plain_zenoh(
    port: int, updates: list[OdometryUpdate], seconds_per_sample: float = 0.0
) -> list[dict[str, Any]]:
    """Publish in lockstep, close, and return the samples that the plain subscriber received."""
    output = ZenohOutput(config(port), LOCKSTEP_QOS)
    with reader(port, len(updates), seconds_per_sample) as process:
        assert output.wait_for_subscriber(10)
        for update in updates:
            output.on_update(update)
        output.close()
        samples: list[dict[str, Any]] = json.loads(process.communicate()[0])
    return samples


@contextmanager
def subscribed(port: int, key: str) -> Iterator[Callable[[], zenoh.Sample]]:
    """Subscribe in this process; yield a function that waits for the next sample."""
    received: SimpleQueue[zenoh.Sample] = SimpleQueue()
    with connected_session(port) as session:
        session.declare_subscriber(key, received.put)
        yield partial(received.get, timeout=10.0)


@pytest.mark.subprocess
def test_a_slow_subscriber_gets_every_pose_in_order(free_port: int) -> None:
    updates = [make_update(seq) for seq in range(450)]
    # Longer than Zenoh's keep-alive period: closing at once would lose the tail.
    samples = read_with_plain_zenoh(free_port, updates, seconds_per_sample=0.01)
    assert [sample["attachment"]["seq"] for sample in samples] == list(range(450))


@pytest.mark.subprocess
def test_rosbags_decodes_the_same_numbers_and_the_attachment_has_the_state(
    free_port: int,
) -> None:
    updates = [make_update(0), make_update(1, ok=False)]
    samples = read_with_plain_zenoh(free_port, updates)
    for update, sample in zip(updates, samples, strict=True):
        message: Any = ROS.deserialize_cdr(
            bytes.fromhex(sample["payload"]), "nav_msgs/msg/Odometry"
        )
        stamp, position = message.header.stamp, message.pose.pose.position
        assert sample["encoding"] == "application/cdr;nav_msgs/msg/Odometry"
        assert stamp.sec + stamp.nanosec * 1e-9 == update.stamp_s
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert [position.x, position.y, position.z] == update.T_odom_base[:3, 3].tolist()
        np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6), update.pose_covariance)
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == list(update.twist)
    assert [sample["attachment"] for sample in samples] == [
        {"schema": 1, "seq": 0, "state": "tracking", "epoch": 1, "reason": ""},
        {"schema": 1, "seq": 1, "state": "lost", "epoch": 1, "reason": "too few matches"},
    ]


def test_the_status_is_json_with_every_field(free_port: int) -> None:
    output = ZenohOutput(config(free_port), LOCKSTEP_QOS)
    with subscribed(free_port, "kinect/*") as next_sample:
        assert output.wait_for_subscriber(10)
        output.on_status(STATUS)
        content = json.loads(next_sample().payload.to_bytes())
    output.close()
    versions = content.pop("versions")
    assert content == {"schema": 1, **json.loads(json.dumps(dataclasses.asdict(STATUS)))}
    assert versions["kinect-vo"].count(".") == 2
    assert versions["eclipse-zenoh"].startswith("1.")


def test_the_liveliness_token_is_there_until_closed(free_port: int) -> None:
    output = ZenohOutput(config(free_port, prefix="robot1/kinect"))
    with connected_session(free_port) as session:
        tokens: Any = session.liveliness().get("*/*/alive", timeout=60)
        assert [str(reply.ok.key_expr) for reply in tokens] == ["robot1/kinect/alive"]
        output.close()
        assert list(session.liveliness().get("**", timeout=1)) == []


@pytest.mark.parametrize("field", ["T_odom_base", "pose_covariance", "twist_covariance"])
def test_a_pose_that_is_not_finite_is_not_published(
    free_port: int, field: str, caplog: pytest.LogCaptureFixture
) -> None:
    values = np.array(getattr(make_update(0), field))
    values[0, 3] = np.nan
    bad: dict[str, Any] = {field: values}
    output = ZenohOutput(config(free_port), LOCKSTEP_QOS)
    with subscribed(free_port, "kinect/odom") as next_sample:
        assert output.wait_for_subscriber(10)
        output.on_update(dataclasses.replace(make_update(0), **bad))
        output.on_update(make_update(1))
        seq = attachment_of(next_sample())["seq"]
    output.close()
    assert seq == 1
    assert output.errors == 1
    assert "not finite" in caplog.text


def test_publishing_without_subscribers_loses_nothing_and_ends(free_port: int) -> None:
    output = ZenohOutput(config(free_port), LIVE_QOS)
    for seq in range(50):
        output.on_update(make_update(seq))
    output.close()
    output.close()
    assert output.errors == 0


@pytest.mark.subprocess
def test_a_frozen_subscriber_does_not_block_a_live_service(free_port: int) -> None:
    output = ZenohOutput(config(free_port), LIVE_QOS)
    update = make_update(0)
    with reader(free_port, 1, 0.0) as process:
        assert output.wait_for_subscriber(10)
        process.send_signal(signal.SIGSTOP)
        for _ in range(20_000):
            output.on_update(update)
        output.close()
        process.kill()
    assert output.dropped > 0
