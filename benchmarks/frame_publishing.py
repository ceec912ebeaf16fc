"""Cost of publishing frames, and latency of poses in another process meanwhile.

    python -m benchmarks frame_publishing RECORDING [--seconds 20] [--case NAME]

The service's outputs publish the recording's frames 30 times a second, without odometry; one
process reads poses, others read images. In each case, `lost frames` is the worst of its readers,
`put` is the time that the loop spends on a frame, and `growth` is that of the publisher's memory in
the second half. Times are milliseconds; CPU is per frame, of the whole publishing process and of
one reader. Poses are stamped when they are published. A case over a link puts all readers into a
network namespace behind it; it needs root and the package iproute2. Compare the cases with each
other: absolute times depend on what else runs on the machine.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.harness import format_table
from benchmarks.network_link import HOST_ADDRESS, network_link
from benchmarks.service_load import running_recorder
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import T_BODY_CAMERA
from drivers.recording_camera import RecordingCamera
from tests.ports import free_port
from tests.resource_leaks import resident_memory_kb
from vo_service.config_tables import FramesConfig, ZenohConfig
from vo_service.outputs.frames import FrameOutput, FrameOutputConfig
from vo_service.outputs.zenoh.endpoints import ExtraEndpoints
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.types import Estimate, OdometryUpdate, TrackingState

RATE_HZ = 30.0
SOURCE_FRAMES = 40
WARM_UP_FRAMES = 60
RAW, COMPRESSED = ("color/image", "depth/image"), ("color/compressed", "depth/compressed")


@dataclass(frozen=True)
class Case:
    """Readers of images.

    Attributes:
        readers: The topics of each reader.
        is_stopped: Whether they are stopped by SIGSTOP after the warm-up.
        link_mbit_s: Capacity of the link to all readers; 0: no link, the same machine.
    """

    readers: Sequence[Sequence[str]] = ()
    is_stopped: bool = False
    link_mbit_s: int = 0


CASES = {
    "no image reader": Case(),
    "one raw reader": Case([RAW]),
    "three raw readers": Case([RAW] * 3),
    "one compressed reader": Case([COMPRESSED]),
    "one stopped raw reader": Case([RAW], is_stopped=True),
    "no image reader, 100 Mbit/s": Case(link_mbit_s=100),
    "one raw reader, 100 Mbit/s": Case([RAW], link_mbit_s=100),
}
# Prints "ready"; then, for a time on its input, the number of later images, and its CPU time.
READER = """
import resource, struct, sys
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh import MAX_FRAME_MESSAGE_BYTES, open_session
stamps_s = []
def on_sample(sample):
    seconds, nanoseconds = struct.unpack_from("<iI", sample.payload.to_bytes(), 4)
    stamps_s.append(seconds + 1e-9 * nanoseconds)
config = ZenohConfig(listen=(), connect=(sys.argv[1],))
with open_session(config, MAX_FRAME_MESSAGE_BYTES) as session:
    for topic in sys.argv[2:]:
        session.declare_subscriber(f"kinect/{topic}", on_sample)
    print("ready", flush=True)
    begin_s = float(sys.stdin.readline())
    count = sum(stamp_s >= begin_s for stamp_s in stamps_s)
    use = resource.getrusage(resource.RUSAGE_SELF)
    print(count, use.ru_utime + use.ru_stime, flush=True)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("recording", metavar="RECORDING", type=Path, help="source of the frames")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a case")
    parser.add_argument("--case", choices=CASES, action="append", help="only this case")


def main(args: argparse.Namespace) -> None:
    """Measure and print the table."""
    if args.seconds < 1.0:
        raise InputError("--seconds: give at least 1")
    names = args.case or [name for name, case in CASES.items() if not case.link_mbit_s]
    with RecordingCamera(args.recording) as camera:
        updates = [make_update(frame) for frame in islice(camera, SOURCE_FRAMES)]
    frames = int(args.seconds * RATE_HZ)
    rows = {name: measure(CASES[name], updates, frames) for name in names}
    headings = (
        "p50 ms",
        "p99 ms",
        "max ms",
        "lost poses",
        "lost frames",
        "put ms",
        "CPU",
        "reader",
        "growth MB",
    )
    print(format_table(headings, rows))


def measure(case: Case, updates: Sequence[OdometryUpdate], count: int) -> list[str]:
    """Run one case; return the cells of its row."""
    config = FrameOutputConfig("kinect", FramesConfig(), T_BODY_CAMERA)
    with ExitStack() as stack:
        address, prefix = "127.0.0.1", list[str]()
        if case.link_mbit_s:
            address, prefix = HOST_ADDRESS, stack.enter_context(network_link(case.link_mbit_s))
        endpoint = f"tcp/{address}:{free_port()}"
        frames = stack.enter_context(closing(FrameOutput(config)))
        extras = ExtraEndpoints(on_session=frames.declare, on_pose=frames.queue)
        poses = stack.enter_context(
            closing(ZenohOutput(ZenohConfig(listen=(endpoint,)), extra_endpoints=extras))
        )
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arrivals = stack.enter_context(running_recorder(endpoint, folder / "poses.npz", prefix))
        readers = [start_reader(stack, prefix, endpoint, topics) for topics in case.readers]
        publish(updates, poses, 0, WARM_UP_FRAMES)
        for reader in readers if case.is_stopped else ():
            reader.send_signal(signal.SIGSTOP)
        begin_stamp_s, begin_s, cpu_s = time.time(), time.monotonic(), time.process_time()
        put_ms = publish(updates, poses, WARM_UP_FRAMES, count // 2)
        half_kb = resident_memory_kb(os.getpid())
        publish(updates, poses, WARM_UP_FRAMES + count // 2, count - count // 2)
        growth_mb = (resident_memory_kb(os.getpid()) - half_kb) / 1e3
        cpu_ms = 1e3 * (time.process_time() - cpu_s) / count
        end_s = time.monotonic()
        time.sleep(0.5)  # the last frames are on their way
        lost, reader_ms = [0], [0.0]
        for reader, topics in zip(readers, case.readers, strict=True):
            if case.is_stopped:
                reader.send_signal(signal.SIGCONT)
                continue
            received, reader_cpu_s = reader.communicate(f"{begin_stamp_s}\n")[0].split()
            lost.append(count * len(topics) - int(received))
            reader_ms.append(1e3 * float(reader_cpu_s) / (count + WARM_UP_FRAMES))
        received_poses = arrivals.stop().between(begin_s, end_s)
    latency_ms = 1e3 * (received_poses.receive_time_s - received_poses.stamp_s)
    p50, p99 = np.percentile(latency_ms, [50, 99])
    milliseconds = [f"{value:.2f}" for value in (p50, p99, latency_ms.max())]
    losses = [str(received_poses.lost), "-" if case.is_stopped else str(max(lost))]
    costs = [f"{put_ms:.3f}", f"{cpu_ms:.2f}", f"{max(reader_ms):.2f}", f"{growth_mb:.1f}"]
    return [*milliseconds, *losses, *costs]


def start_reader(
    stack: ExitStack, prefix: Sequence[str], endpoint: str, topics: Sequence[str]
) -> "subprocess.Popen[str]":
    """Start a reader process; wait until it subscribes."""
    reader = subprocess.Popen(
        [*prefix, sys.executable, "-c", READER, endpoint, *topics],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    stack.callback(reader.wait)
    stack.callback(reader.kill)
    assert reader.stdout is not None
    reader.stdout.readline()
    return reader


def publish(
    updates: Sequence[OdometryUpdate],
    poses: ZenohOutput,
    first: int,
    count: int,
) -> float:
    """Publish at the frame rate; return the mean time that the output took of the loop, ms."""
    begin_s, busy_s = time.monotonic(), 0.0
    for i in range(count):
        time.sleep(max(0.0, begin_s + i / RATE_HZ - time.monotonic()))
        update = replace(updates[i % len(updates)], seq=first + i, stamp_s=time.time())
        started_s = time.perf_counter()
        poses.on_update(update)
        busy_s += time.perf_counter() - started_s
    # The next call goes on at the same rate.
    time.sleep(max(0.0, begin_s + count / RATE_HZ - time.monotonic()))
    return 1e3 * busy_s / count


def make_update(frame: RgbdFrame) -> OdometryUpdate:
    """Make the update of a camera at rest that sees the frame."""
    identity = np.eye(4)
    return OdometryUpdate(
        seq=0,
        stamp_s=0.0,
        state=TrackingState.TRACKING,
        reason="",
        epoch=0,
        T_world_camera=identity,
        T_odom_base=identity,
        T_odom_camera=identity,
        pose_covariance=np.eye(6),
        twist=np.zeros(6),
        twist_covariance=np.eye(6),
        frame=frame,
        estimate=Estimate(True, "", identity, identity, np.eye(6)),
        stage_ms={},
        latency_s=0.0,
    )
