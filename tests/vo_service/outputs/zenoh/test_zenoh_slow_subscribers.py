"""A healthy subscriber receives every pose, even if others or the router fail."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import PoseSubscriber, connected_session
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import LIVE_QOS, ConnectWithRetry, ZenohOutput

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

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


@pytest.mark.parametrize("fate", [signal.SIGSTOP, signal.SIGKILL])
def test_a_frozen_or_killed_subscriber_does_not_affect_others(
    free_port: int, fate: signal.Signals
) -> None:
    updates = [make_update(seq) for seq in range(300)]
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with (
        closing(ZenohOutput(ZenohConfig(listen=(endpoint,)), LIVE_QOS, ConnectWithRetry)) as output,
        connected_session(free_port) as session,
        running(READER, endpoint) as other,
    ):
        healthy = PoseSubscriber(session, output)
        waiting = threading.Thread(target=wait_until_ready, args=(other,))
        waiting.start()
        while waiting.is_alive():
            assert healthy.receives_all(updates[:1])
        other.send_signal(fate)
        assert healthy.receives_all(updates)
