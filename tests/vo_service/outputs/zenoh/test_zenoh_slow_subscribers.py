"""A healthy subscriber receives every pose, even if others or the router fail."""

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from queue import SimpleQueue

import pytest
import zenoh

from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import connected_session
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import LIVE_QOS, ConnectWithRetry, ZenohOutput
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

COUNT = 300
READER = """
import sys, zenoh
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session
session = open_session(ZenohConfig(listen=(), connect=(sys.argv[1],)))
session.declare_subscriber("kinect/odom", lambda sample: print("ready", flush=True))
input()
"""


@contextmanager
def running(program: str, endpoint: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-c", program, endpoint]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until_ready(process: "subprocess.Popen[str]") -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"


class HealthySubscriber:
    """A subscriber in this process."""

    def __init__(self, session: zenoh.Session, output: ZenohOutput) -> None:
        self._output = output
        self._received: SimpleQueue[int] = SimpleQueue()
        session.declare_subscriber("kinect/odom", self._take)
        assert output.wait_for_subscriber(20)

    def _take(self, sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        self._received.put(json.loads(sample.attachment.to_bytes())["seq"])

    def receives_all(self, updates: list[OdometryUpdate]) -> bool:
        """Return whether each pose is received before the next one is published."""
        for update in updates:
            self._output.on_update(update)
            if self._received.get(timeout=100) != update.seq:
                return False
        return (self._output.dropped, self._output.errors) == (0, 0)


@pytest.fixture
def updates() -> list[OdometryUpdate]:
    return [make_update(seq) for seq in range(COUNT)]


@pytest.mark.parametrize("fate", [signal.SIGSTOP, signal.SIGKILL])
def test_a_frozen_or_killed_subscriber_does_not_affect_others(
    free_port: int, updates: list[OdometryUpdate], fate: signal.Signals
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with (
        closing(ZenohOutput(ZenohConfig(listen=(endpoint,)), LIVE_QOS, ConnectWithRetry)) as output,
        connected_session(free_port) as session,
        running(READER, endpoint) as other,
    ):
        healthy = HealthySubscriber(session, output)
        waiting = threading.Thread(target=wait_until_ready, args=(other,))
        waiting.start()
        while waiting.is_alive():
            assert healthy.receives_all(updates[:1])
        other.send_signal(fate)
        assert healthy.receives_all(updates)
