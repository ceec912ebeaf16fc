"""A subscriber outside the container that receives the service's messages."""

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import zenoh

from benchmarks.boot_container import wait_for

SETTINGS = """{{mode: "peer", connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}},
    listen: {{endpoints: []}}, scouting: {{multicast: {{enabled: false}}}}}}"""


class BootListener:
    """Counts poses and stores the last status."""

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self.poses = 0
        self.status: Mapping[str, Any] = {}
        self._session, self._prefix = session, prefix
        self._subscribers = [
            session.declare_subscriber(f"{prefix}/odom", self._on_pose),
            session.declare_subscriber(f"{prefix}/status", self._on_status),
        ]

    def wait_for_poses(self, count: int, limit_s: float) -> float:
        """Wait for `count` more poses; return the seconds. Raises AssertionError when too late."""
        before = self.poses
        return wait_for(lambda: self.poses >= before + count, limit_s, f"{count} poses")

    def measure_pose_rate(self, seconds: float) -> float:
        """Measure the poses per second over `seconds`."""
        before = self.poses
        time.sleep(seconds)
        return (self.poses - before) / seconds

    def send_command(self, name: str) -> str:
        """Send the service a command and return its reply."""
        replies = self._session.get(f"{self._prefix}/command/{name}", payload=b"{}", timeout=5.0)
        for reply in replies:
            result = reply.ok
            assert result is not None, f"{name} was refused: {reply.err and reply.err.payload}"
            return result.payload.to_string()
        raise AssertionError(f"no reply to {name}")

    def _on_pose(self, sample: zenoh.Sample) -> None:
        self.poses += 1

    def _on_status(self, sample: zenoh.Sample) -> None:
        self.status = json.loads(sample.payload.to_bytes())


@contextmanager
def running_listener(port: int, prefix: str = "kinect") -> Iterator[BootListener]:
    """Open a listener for the service on a port of this computer."""
    with zenoh.open(zenoh.Config.from_json5(SETTINGS.format(port=port))) as session:
        yield BootListener(session, prefix)
