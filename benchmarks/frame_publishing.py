"""Cost of publishing frames, and latency of poses in another process meanwhile.

    python -m benchmarks frame_publishing [--seconds 20] [--case NAME]

The service's outputs publish noisy frames of a Kinect's size 30 times a second, without odometry;
one process reads poses, others read images. In each case, `lost frames` is the worst of its
readers, and `put` is the time that the loop spends on a frame. Times are milliseconds; CPU is per
frame, of the whole publishing process and of one reader. Poses are stamped when they are published.
Compare the cases with each other: absolute times depend on what else runs on the machine.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import format_table
from benchmarks.pose_arrivals import running_recorder
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.errors import InputError
from drivers.core.geometry import T_BODY_CAMERA
from tests.ports import free_port
from vo_service.config_tables import FramesConfig, ZenohConfig
from vo_service.outputs.frames.output import FrameOutput, FrameOutputConfig
from vo_service.outputs.zenoh.output import ExtraEndpoints, ZenohOutput
from vo_service.types import Estimate, OdometryUpdate, TrackingState

CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
RATE_HZ = 30.0
WARM_UP_FRAMES = 60
RAW, COMPRESSED = ("color/image", "depth/image"), ("color/compressed", "depth/compressed")


@dataclass(frozen=True)
class Case:
    """Readers of images: the topics of each, and whether they are stopped by SIGSTOP."""

    readers: Sequence[Sequence[str]] = ()
    is_stopped: bool = False


CASES = {
    "no image reader": Case(),
    "one raw reader": Case([RAW]),
    "three raw readers": Case([RAW] * 3),
    "one compressed reader": Case([COMPRESSED]),
    "one stopped raw reader": Case([RAW], is_stopped=True),
}
# Prints "ready", then at the end of its input the number of samples, and its CPU time.
READER = """
import resource, sys, threading
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import MAX_FRAME_MESSAGE_BYTES, open_session
count = 0
def on_sample(sample):
    global count
    count += 1
    sample.payload.to_bytes()
config = ZenohConfig(listen=(), connect=(sys.argv[1],))
with open_session(config, MAX_FRAME_MESSAGE_BYTES) as session:
    for topic in sys.argv[2:]:
        session.declare_subscriber(f"kinect/{topic}", on_sample)
    print("ready", flush=True)
    sys.stdin.readline()
    use = resource.getrusage(resource.RUSAGE_SELF)
    print(count, use.ru_utime + use.ru_stime, flush=True)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a case")
    parser.add_argument("--case", choices=CASES, help="only this case")


def main(args: argparse.Namespace) -> None:
    """Measure and print the table."""
    if args.seconds < 1.0:
        raise InputError("--seconds: give at least 1")
    names = [args.case] if args.case else list(CASES)
    frames = int(args.seconds * RATE_HZ)
    rows = {name: measure(CASES[name], frames) for name in names}
    headings = (
        "p50 ms",
        "p99 ms",
        "max ms",
        "lost poses",
        "lost frames",
        "put ms",
        "CPU",
        "reader",
    )
    print(format_table(headings, rows))


def measure(case: Case, count: int) -> list[str]:
    """Run one case; return the cells of its row."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = FrameOutputConfig("kinect", FramesConfig(), T_BODY_CAMERA)
    with ExitStack() as stack:
        frames = stack.enter_context(closing(FrameOutput(config)))
        extras = ExtraEndpoints(on_session=frames.declare)
        poses = stack.enter_context(
            closing(ZenohOutput(ZenohConfig(listen=(endpoint,)), extra_endpoints=extras))
        )
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arrivals = stack.enter_context(running_recorder(endpoint, folder / "poses.npz"))
        readers = [start_reader(stack, endpoint, topics) for topics in case.readers]
        updates = make_updates()
        publish(updates, (poses, frames), 0, WARM_UP_FRAMES)
        for reader in readers if case.is_stopped else ():
            reader.send_signal(signal.SIGSTOP)
        begin_s, cpu_s = time.monotonic(), time.process_time()
        put_ms = publish(updates, (poses, frames), WARM_UP_FRAMES, count)
        cpu_ms = 1e3 * (time.process_time() - cpu_s) / count
        end_s = time.monotonic()
        time.sleep(0.5)  # the last frames are on their way
        lost, reader_ms = [0], [0.0]
        for reader, topics in zip(readers, case.readers, strict=True):
            if case.is_stopped:
                reader.send_signal(signal.SIGCONT)
                continue
            received, reader_cpu_s = reader.communicate("\n")[0].split()
            lost.append((count + WARM_UP_FRAMES) * len(topics) - int(received))
            reader_ms.append(1e3 * float(reader_cpu_s) / (count + WARM_UP_FRAMES))
        received_poses = arrivals.stop().between(begin_s, end_s)
    latency_ms = 1e3 * (received_poses.receive_time_s - received_poses.stamp_s)
    p50, p99 = np.percentile(latency_ms, [50, 99])
    milliseconds = [f"{value:.2f}" for value in (p50, p99, latency_ms.max())]
    losses = [str(received_poses.lost), "-" if case.is_stopped else str(max(lost))]
    return [*milliseconds, *losses, f"{put_ms:.3f}", f"{cpu_ms:.2f}", f"{max(reader_ms):.2f}"]


def start_reader(stack: ExitStack, endpoint: str, topics: Sequence[str]) -> "subprocess.Popen[str]":
    """Start a reader process; wait until it subscribes."""
    reader = subprocess.Popen(
        [sys.executable, "-c", READER, endpoint, *topics],
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
    outputs: Sequence[ZenohOutput | FrameOutput],
    first: int,
    count: int,
) -> float:
    """Publish at the frame rate; return the mean time that the outputs took of the loop, ms."""
    begin_s, busy_s = time.monotonic(), 0.0
    for i in range(count):
        time.sleep(max(0.0, begin_s + i / RATE_HZ - time.monotonic()))
        update = replace(updates[i % len(updates)], seq=first + i, stamp_s=time.time())
        started_s = time.perf_counter()
        for output in outputs:
            output.on_update(update)
        busy_s += time.perf_counter() - started_s
    return 1e3 * busy_s / count


def make_updates() -> list[OdometryUpdate]:
    """Make updates with different images: smooth, with the noise of a Kinect."""
    random = np.random.default_rng(1)
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    updates = []
    for shift in range(8):
        texture = 100 + 60 * np.sin((columns + 9 * shift) / 9) * np.cos(rows / 13)
        color = np.repeat(texture[:, :, None], 3, axis=2) + random.normal(0, 3, (*rows.shape, 3))
        depth = 1500 + 2 * columns + rows + random.normal(0, 4, rows.shape)
        depth[random.random(rows.shape) < 0.2] = 0
        frame = RgbdFrame(
            0, 0.0, 0.0, color.astype(np.uint8), depth.astype(np.uint16), 1000.0, CAMERA
        )
        identity = np.eye(4)
        estimate = Estimate(True, "", identity, identity, np.eye(6))
        updates.append(
            OdometryUpdate(
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
                estimate=estimate,
                stage_ms={},
                latency_s=0.0,
            )
        )
    return updates
