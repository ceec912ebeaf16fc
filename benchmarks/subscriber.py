"""A subscriber in a process of its own, which records when messages arrive.

python -m benchmarks.subscriber SOURCE KEY...
"""

import json
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.piped_process import PipedProcess, print_ready, running_process
from drivers.core.geometry import Array
from drivers.ros_messages.decoding import decode_odometry
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.zenoh_config import MAX_FRAME_MESSAGE_BYTES

MAX_CLOCK_SHIFT_S = 1e-3


@dataclass(frozen=True)
class Arrivals:
    """The received messages, one entry each; times are those of CLOCK_MONOTONIC.

    Attributes:
        receive_time_s: When the message was decoded.
        stamp_s: Its stamp.
        seq: Number of its frame.
        cpu_s: Processor time of the subscriber since it was ready.
    """

    receive_time_s: Array
    stamp_s: Array
    seq: Array
    cpu_s: float

    def __len__(self) -> int:
        return len(self.seq)

    def between(self, begin_s: float, end_s: float = np.inf) -> "Arrivals":
        """Return the messages with stamps between two times."""
        inside = (self.stamp_s >= begin_s) & (self.stamp_s < end_s)
        return Arrivals(
            self.receive_time_s[inside], self.stamp_s[inside], self.seq[inside], self.cpu_s
        )

    @property
    def lost(self) -> int:
        """Number of frames between the first and the last whose message was not received."""
        return int(self.seq[-1] - self.seq[0]) + 1 - len(self.seq) if len(self.seq) else 0

    @property
    def latency_ms(self) -> Array:
        """Time from the stamp of each message until it was decoded."""
        return 1e3 * (self.receive_time_s - self.stamp_s)

    @property
    def latency_spread_ms(self) -> tuple[float, float, float]:
        """Median, 99th percentile and maximum of the latency; 0 without messages."""
        latency_ms = self.latency_ms if len(self) else np.zeros(1)
        median_ms, p99_ms, max_ms = np.percentile(latency_ms, (50, 99, 100)).tolist()
        return median_ms, p99_ms, max_ms


def end_subscriber(process: PipedProcess) -> Arrivals:
    """End a subscriber and return what it received.

    Raises:
        RuntimeError: The wall clock was set meanwhile, so that stamps are of two clocks.
    """
    result = process.end()
    begin_s, end_s = result["clock_s"]
    if abs(end_s - begin_s) > MAX_CLOCK_SHIFT_S:
        raise RuntimeError("the wall clock was set during the run: re-run")
    receive_time_s, stamp_s, seq = np.array(result["arrivals"]).reshape(-1, 3).T
    return Arrivals(receive_time_s, stamp_s - begin_s, seq, result["cpu_s"])


@contextmanager
def running_subscriber(
    source: str | Path, *keys: str, prefix: Sequence[str] = ()
) -> Iterator[PipedProcess]:
    """Run a subscriber in a separate process that is ready; kill it at the end.

    Args:
        source: Endpoint that it connects to, or its Zenoh file.
        keys: Key expressions of the messages: poses, or images.
        prefix: Command that starts it elsewhere, such as in a network namespace.
    """
    command = (*prefix, sys.executable, "-m", "benchmarks.subscriber", source, *keys)
    with running_process(*command) as process:
        process.wait_until_ready()
        yield process


def record_arrivals(source: str, keys: Sequence[str]) -> None:
    """Subscribe until "end" on standard input; print the arrival of each message."""
    arrivals: dict[tuple[str, int], tuple[float, float, int]] = {}

    def receive(sample: zenoh.Sample) -> None:
        payload, key = sample.payload.to_bytes(), str(sample.key_expr)
        stamp_s = decode_odometry(payload).stamp_s if key.endswith("odom") else read_stamp(payload)
        receive_time_s, attachment = time.monotonic(), sample.attachment
        fields = json.loads(attachment.to_bytes()) if attachment else {}
        seq = fields.get("seq", len(arrivals))
        arrivals.setdefault((key, seq), (receive_time_s, stamp_s, seq))

    is_endpoint = source.startswith("tcp/")
    config = ZenohConfig(
        listen=(),
        connect=(source,) if is_endpoint else (),
        config_file=None if is_endpoint else Path(source),
    )
    begin_s = wall_clock_offset_s()
    with open_session(config, MAX_FRAME_MESSAGE_BYTES) as session:
        subscribers = [session.declare_subscriber(key, receive) for key in keys]
        print_ready()
        cpu_s = time.process_time()
        sys.stdin.readline()
        del subscribers
    result = {
        "arrivals": list(arrivals.values()),
        "clock_s": (begin_s, wall_clock_offset_s()),
        "cpu_s": time.process_time() - cpu_s,
    }
    print(json.dumps(result), flush=True)


def read_stamp(payload: bytes) -> float:
    """Stamp of a message that begins with a header."""
    seconds, nanoseconds = struct.unpack_from("<iI", payload, 4)
    return float(seconds + 1e-9 * nanoseconds)


def wall_clock_offset_s() -> float:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC, from the least interrupted of several readings."""
    readings = []
    for _ in range(20):
        before_s, wall_s, after_s = time.monotonic(), time.time(), time.monotonic()
        readings.append((after_s - before_s, wall_s - 0.5 * (before_s + after_s)))
    return min(readings)[1]


if __name__ == "__main__":
    record_arrivals(sys.argv[1], sys.argv[2:])
