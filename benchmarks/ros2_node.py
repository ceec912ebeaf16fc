"""Latency and cost of the ROS 2 node: from the stamp of a frame to a callback in another process.

    scripts/setup_ros2.sh
    python -m benchmarks ros2_node RECORDING [--seconds 60] [--python .ros2/kilted/bin/python]

Frames of RECORDING are published 30 times a second, without odometry, and stamped then. In each
case the node passes them on to a reader with rclpy. `lost` counts messages between a reader's first
and last, CPU is the share of one core that the node takes. Compare the cases with each other:
absolute times depend on what else runs on the machine.
"""

import argparse
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.frame_sender import (
    RATE_HZ,
    WARM_UP_FRAMES,
    load_frames,
    make_update,
    send_in_turn,
)
from benchmarks.harness import RECORDING, Table, option
from benchmarks.outputs import publishing
from benchmarks.piped_process import running_process
from benchmarks.processes import LoadMeter, proportional_mb
from drivers.core import InputError
from tests.ports import free_port
from vo_service.types.odometry_update import OdometryUpdate

ROOT = Path(__file__).parents[1]
DEFAULT_PYTHON = ROOT / ".ros2" / "kilted" / "bin" / "python"
TABLE = Table(
    *(54, "p50 ms:8.2f", "p99 ms:8.2f", "max ms:8.2f", "lost:14", "node %:8.1f", "node MB:9.0f")
)
SOURCE_FRAMES = 40
# Not that of any robot of the user.
DOMAIN_ID = 87
DISCOVERY_S = 4.0
ODOM = ("odom", "nav_msgs.msg", "Odometry")
COLOR = ("camera/rgb/image_raw", "sensor_msgs.msg", "Image")


@dataclass(frozen=True)
class Case:
    """Topics that one process reads, and with which reliability."""

    topics: Sequence[tuple[str, str, str]] = ()
    reliability: str = "BEST_EFFORT"


CASES = {
    "no reader": Case(),
    "odom": Case([ODOM]),
    "odom and color, best effort": Case([ODOM, COLOR]),
    "odom and color, reliable": Case([ODOM, COLOR], "RELIABLE"),
}
# Prints "ready"; after a line on its input, stamp and latency of each message by topic.
READER = """
import importlib, json, struct, sys, threading, time
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
topics, reliability = json.loads(sys.argv[1]), ReliabilityPolicy[sys.argv[2]]
received = {name: [] for name, _, _ in topics}
def subscribe(node, name, module, kind):
    def on_message(payload):
        now_s = time.time()
        seconds, nanoseconds = struct.unpack_from("<iI", payload, 4)
        received[name].append((seconds + 1e-9 * nanoseconds, now_s))
    message = getattr(importlib.import_module(module), kind)
    qos = QoSProfile(depth=5, reliability=reliability)
    node.create_subscription(message, name, on_message, qos, raw=True)
rclpy.init()
node = rclpy.create_node("benchmark_reader")
for topic in topics:
    subscribe(node, *topic)
is_over = threading.Event()
threading.Thread(target=lambda: (sys.stdin.readline(), is_over.set()), daemon=True).start()
print("ready", flush=True)
while not is_over.is_set():
    rclpy.spin_once(node, timeout_sec=0.1)
print(json.dumps(received))
"""


@RECORDING
@option("--seconds", type=float, default=60.0, help="length of a case")
@option("--python", type=Path, default=DEFAULT_PYTHON, help="a Python that has rclpy")
def main(args: argparse.Namespace) -> None:
    """Measure all cases in turn."""
    if not args.python.exists():
        raise InputError(f"{args.python}: no such file; run scripts/setup_ros2.sh")
    updates = list(map(make_update, load_frames(args.recording, SOURCE_FRAMES)))
    print(TABLE.head)
    for name, case in CASES.items():
        for topic, cells in measure_case(case, updates, args).items():
            print(TABLE.row(f"{name}: {topic}", *cells), flush=True)


def measure_case(
    case: Case, updates: Sequence[OdometryUpdate], args: argparse.Namespace
) -> dict[str, list[float | str | None]]:
    """Run one case; return the cells of a row for each topic, or of one row without a reader."""
    count, endpoint = int(args.seconds * RATE_HZ), f"tcp/127.0.0.1:{free_port()}"
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(DOMAIN_ID),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": str(ROOT / "ros2"),
    }
    arguments = ("-m", "kinect_vo_ros2", "--ros-args", "-p", f"connect:={endpoint}")
    topics = json.dumps(case.topics)
    with (
        publishing(endpoint) as poses,
        running_process(args.python, *arguments, environment=environment) as node,
        running_process(
            *(args.python, "-c", READER, topics, case.reliability), environment=environment
        ) as reader,
    ):
        reader.wait_until_ready()
        time.sleep(DISCOVERY_S)
        send_in_turn(updates, 0, WARM_UP_FRAMES, poses.on_update)
        begin_s, meter = time.time(), LoadMeter(node.pid)
        send_in_turn(updates, WARM_UP_FRAMES, count, poses.on_update)
        cost = [meter.read().percent(), proportional_mb(node.pid)]
        end_s = time.time()
        time.sleep(0.5)  # the last messages are on their way
        received: Mapping[str, Sequence[tuple[float, float]]] = reader.end()
        node.terminate()
        node.wait()
    if not case.topics:
        return {"-": [None, None, None, None, *cost]}
    return {
        topic: [*describe(np.array(times), begin_s, end_s, count), *cost]
        for topic, times in received.items()
    }


def describe(
    times_s: np.ndarray[tuple[int, int], np.dtype[np.float64]],
    begin_s: float,
    end_s: float,
    count: int,
) -> list[float | str]:
    """Return latencies and losses of one topic.

    Args:
        times_s: (N, 2) stamp and arrival of each message.
        begin_s: Messages with earlier stamps do not count.
        end_s: Messages with later stamps do not count.
        count: Number of messages that were sent between the two.
    """
    inside = times_s[(times_s[:, 0] >= begin_s) & (times_s[:, 0] < end_s)]
    latency_ms = 1e3 * (inside[:, 1] - inside[:, 0])
    lost = f"{count - len(inside)} of {count}"
    return [*np.percentile(latency_ms, [50, 99]), latency_ms.max(), lost]
