"""Receive times of poses in another process, measured by a plain subscriber.

    python -m benchmarks pose_arrivals ENDPOINT FILE

It prints "ready" once it subscribes, and collects poses until its standard input is closed. Then it
writes FILE (.npz). `running_recorder` starts it and returns the received poses.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zenoh

from drivers.core.geometry import Array
from vo_service.ros_messages.navigation import decode_odometry

KEY = "kinect/odom"
STOP_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class PoseArrivals:
    """The received poses, one entry each.

    Attributes:
        receive_time_s: CLOCK_MONOTONIC once the message was decoded.
        stamp_s: Stamps of the poses, on CLOCK_MONOTONIC.
        seq: Numbers of the poses.
        clock_shift_s: Change of the wall clock during the run; the stamps have this error.
    """

    receive_time_s: Array
    stamp_s: Array
    seq: Array
    clock_shift_s: float

    def between(self, begin_s: float, end_s: float) -> "PoseArrivals":
        """Return the poses with stamps between two times."""
        inside = (self.stamp_s >= begin_s) & (self.stamp_s < end_s)
        return PoseArrivals(
            self.receive_time_s[inside], self.stamp_s[inside], self.seq[inside], self.clock_shift_s
        )

    @property
    def lost(self) -> int:
        """Number of poses between the first and the last that were not received."""
        return int(self.seq[-1] - self.seq[0]) + 1 - len(self.seq) if len(self.seq) else 0


class ArrivalRecorder:
    """A running subscriber process."""

    def __init__(self, process: "subprocess.Popen[bytes]", file: Path) -> None:
        self.process, self._file = process, file

    def stop(self) -> PoseArrivals:
        """Stop the subscriber and return the poses that it received."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        if self.process.wait(STOP_TIMEOUT_S) != 0:
            raise RuntimeError("the subscriber failed")
        with np.load(self._file) as arrays:
            clock_s = arrays["clock_s"]
            receive_time_s, stamp_s, seq = arrays["poses"].T
        shift_s = float(clock_s[1] - clock_s[0])
        return PoseArrivals(receive_time_s, stamp_s - clock_s[0], seq, shift_s)


@contextmanager
def running_recorder(
    endpoint: str, file: Path, prefix: Sequence[str] = ()
) -> Iterator[ArrivalRecorder]:
    """Run a subscriber in a separate process until it is ready; kill it at the end.

    Args:
        endpoint: Where it connects to.
        file: File of the received poses.
        prefix: Command that starts it elsewhere, such as in a network namespace.
    """
    command = [*prefix, sys.executable, "-m", "benchmarks.pose_arrivals", endpoint, str(file)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            if process.stdout.readline() != b"ready\n":
                raise RuntimeError("the subscriber did not start")
            yield ArrivalRecorder(process, file)
        finally:
            process.kill()


def main(endpoint: str, file: Path) -> None:
    """Subscribe until standard input is closed; see the module."""
    poses: list[tuple[float, float, int]] = []

    def receive(sample: zenoh.Sample) -> None:
        stamp_s = decode_odometry(sample.payload.to_bytes()).stamp_s
        receive_time_s = time.monotonic()
        attachment = sample.attachment
        assert attachment is not None
        poses.append((receive_time_s, stamp_s, json.loads(attachment.to_bytes())["seq"]))

    settings: dict[str, object] = {
        "mode": "peer",
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    begin_s = wall_clock_offset_s()
    with zenoh.open(config) as session, session.declare_subscriber(KEY, receive):
        print("ready", flush=True)
        sys.stdin.read()
    clock_s = np.array([begin_s, wall_clock_offset_s()])
    np.savez(file, poses=np.array(poses, np.float64).reshape(-1, 3), clock_s=clock_s)


def wall_clock_offset_s() -> float:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC, from the least interrupted of several readings."""
    readings = []
    for _ in range(20):
        before_s, wall_s, after_s = time.monotonic(), time.time(), time.monotonic()
        readings.append((after_s - before_s, wall_s - 0.5 * (before_s + after_s)))
    return min(readings)[1]


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
