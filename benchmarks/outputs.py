"""Cost of the outputs of frames: Zenoh, a recording into MCAP, its encodings, the flight recorder.

Frames of RECORDING are sent from memory 30 times a second, without odometry. Times are
milliseconds; CPU is per frame.
"""

import argparse
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType

from benchmarks.frame_sender import RATE_HZ, WARM_UP_FRAMES, load_frames, make_update, send_in_turn
from benchmarks.harness import RECORDING, Table, Variants, measure_cpu_ms, option, run_in_turn
from benchmarks.processes import LoadMeter, memory_mb
from benchmarks.subscriber import end_subscriber, running_subscriber, wall_clock_offset_s
from drivers.bag.bag_writer import McapWriter
from drivers.bag.frame_writer import FrameWriter
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import T_BODY_CAMERA
from drivers.playback.recording_formats import open_recording
from drivers.recording.frame_encoding import FrameStamps, calibration_of_frame
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.recording_sink import StoredFrame
from tests.ports import free_port
from tests.resource_leaks import child_pids_of
from tests.waiting import wait_until
from vo_service.config_tables import FramesConfig, RecorderConfig, ZenohConfig
from vo_service.outputs.frames.frame_messages import depth_in_mm
from vo_service.outputs.frames.output import FrameOutput, FrameOutputConfig
from vo_service.outputs.recorder.client import FlightRecorder
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints
from vo_service.types.odometry_update import OdometryUpdate

# Frames of the recording that are published in turn, and those that are recorded.
PUBLISHED_FRAMES, RECORDED_FRAMES = 40, 100
RAW = ("kinect/color/image", "kinect/depth/image")
COMPRESSED = ("kinect/color/compressed", "kinect/depth/compressed")
HOST_ADDRESS, READER_ADDRESS = "10.213.77.1", "10.213.77.2"
NAMESPACE = "kinect-vo-link"
HOST_END, READER_END = "kvo-host", "kvo-reader"
FRAMES_TABLE = Table(
    *(28, "p50 ms:8.2f", "p99 ms:8.2f", "max ms:8.2f", "lost poses:12d", "lost frames:13d"),
    *("put ms:8.3f", "CPU:7.2f", "reader:8.2f", "growth MB:11.1f"),
)
MCAP_TABLE = Table(
    *(10, "sent:7d", "read back:11d", "CPU ms:8.1f", "core %:8.0f", "longest write ms:18.0f"),
    "MB:7.0f",
)
ENCODINGS_TABLE = Table(34, "CPU ms:8.1f", "kB a frame:12.0f", "MB/s:7.1f")
RECORDER_TABLE = Table(16, "service ms:12.2f", "worker ms:11.2f", "missed:8d")


@dataclass(frozen=True)
class Case:
    """Readers of images.

    Attributes:
        readers: The keys of each reader.
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


@contextmanager
def network_link(capacity_mbit_s: int) -> Iterator[list[str]]:
    """Make a link to a new network namespace; remove both at the end.

    Args:
        capacity_mbit_s: Rate of the data that leave this side.

    Returns:
        The command that runs another command behind the link. That reaches this side at
        `HOST_ADDRESS`.

    Raises:
        InputError: Not run as root, or the package iproute2 is not installed.
    """
    if os.geteuid() != 0 or shutil.which("tc") is None:
        raise InputError("a case with a link needs root and `apt-get install iproute2`")
    inside = ["ip", "netns", "exec", NAMESPACE]
    subprocess.run(["ip", "netns", "del", NAMESPACE], check=False, stderr=subprocess.DEVNULL)
    try:
        for command in (
            ["ip", "netns", "add", NAMESPACE],
            ["ip", "link", "add", HOST_END, "type", "veth", "peer", READER_END],
            ["ip", "link", "set", READER_END, "netns", NAMESPACE],
            ["ip", "address", "add", f"{HOST_ADDRESS}/30", "dev", HOST_END],
            ["ip", "link", "set", HOST_END, "up"],
            [*inside, "ip", "address", "add", f"{READER_ADDRESS}/30", "dev", READER_END],
            [*inside, "ip", "link", "set", READER_END, "up"],
            [
                *("tc", "qdisc", "add", "dev", HOST_END, "root", "tbf", "burst", "32kbit"),
                *("rate", f"{capacity_mbit_s}mbit", "latency", "50ms"),
            ],
        ):
            subprocess.run(command, check=True)
        # Another computer has no shared memory with this one; without locked memory, none is used.
        yield [*inside, "prlimit", "--memlock=0"]
    finally:
        subprocess.run(["ip", "netns", "del", NAMESPACE], check=False)


@RECORDING
@option("--seconds", type=float, default=20.0, help="length of a case")
@option("--case", choices=CASES, action="append", help="only this case")
def measure_publishing(args: argparse.Namespace) -> None:
    """Cost of publishing frames, and latency of poses in another process meanwhile.

    One process reads poses, others read images. In each case, `lost frames` is the worst of its
    readers, `put` is the time that the loop spends on a frame, and `growth` is that of the
    publisher's memory in the second half. CPU is that of the whole publishing process and of one
    reader. Poses are stamped when they are published. A case over a link puts all readers into a
    network namespace behind it; it needs root and the package iproute2. Compare the cases with each
    other: absolute times depend on what else runs on the machine.
    """
    if args.seconds < 1.0:
        raise InputError("--seconds: give at least 1")
    names = args.case or [name for name, case in CASES.items() if not case.link_mbit_s]
    updates = list(map(make_update, load_frames(args.recording, PUBLISHED_FRAMES)))
    print(FRAMES_TABLE.head)
    for name in names:
        cells = measure_case(CASES[name], updates, int(args.seconds * RATE_HZ))
        print(FRAMES_TABLE.row(name, *cells), flush=True)


@contextmanager
def publishing(endpoint: str) -> Iterator[ZenohOutput]:
    """Publish poses and frames at an endpoint."""
    config = FrameOutputConfig("kinect", FramesConfig(), T_BODY_CAMERA)
    with closing(FrameOutput(config)) as frames:
        extras = ExtraEndpoints(on_session=frames.declare, on_pose=frames.queue)
        zenoh_config = ZenohConfig(listen=(endpoint,))
        with closing(ZenohOutput(zenoh_config, extra_endpoints=extras)) as poses:
            yield poses


def measure_case(
    case: Case, updates: Sequence[OdometryUpdate], count: int
) -> tuple[float | None, ...]:
    """Run one case; return the cells of its row."""
    with ExitStack() as stack:
        address, prefix = "127.0.0.1", list[str]()
        if case.link_mbit_s:
            address, prefix = HOST_ADDRESS, stack.enter_context(network_link(case.link_mbit_s))
        endpoint = f"tcp/{address}:{free_port()}"
        output = stack.enter_context(publishing(endpoint))
        start = partial(running_subscriber, endpoint, prefix=prefix)
        pose_reader = stack.enter_context(start("kinect/odom"))
        readers = [stack.enter_context(start(*keys)) for keys in case.readers]
        send_in_turn(updates, 0, WARM_UP_FRAMES, output.on_update)
        for reader in readers if case.is_stopped else ():
            reader.send_signal(signal.SIGSTOP)
        begin_s, cpu_s = time.time() - wall_clock_offset_s(), time.process_time()
        taken_s = send_in_turn(updates, WARM_UP_FRAMES, count // 2, output.on_update)
        half_mb = memory_mb(os.getpid(), "VmRSS")
        first = WARM_UP_FRAMES + count // 2
        send_in_turn(updates, first, count - count // 2, output.on_update)
        growth_mb = memory_mb(os.getpid(), "VmRSS") - half_mb
        cpu_ms = 1e3 * (time.process_time() - cpu_s) / count
        time.sleep(0.5)  # the last frames are on their way
        running = [] if case.is_stopped else readers
        images = [end_subscriber(reader).between(begin_s) for reader in running]
        poses = end_subscriber(pose_reader).between(begin_s)
    lost = [count * len(keys) - len(each) for keys, each in zip(case.readers, images, strict=False)]
    return (
        *(*poses.latency_spread_ms, poses.lost),
        None if case.is_stopped else max(lost, default=0),
        *(1e3 * float(np.mean(taken_s)), cpu_ms),
        max((1e3 * each.cpu_s / (count + WARM_UP_FRAMES) for each in images), default=0.0),
        growth_mb,
    )


@RECORDING
@option("--seconds", type=float, default=60.0, help="duration (default: 60)")
def measure_mcap(args: argparse.Namespace) -> None:
    """Cost and completeness of a recording into MCAP, with color as JPEG, then raw.

    The table shows the frames that were written and read back, the CPU time per frame, its share of
    one core at 30 Hz, and the longest time that the camera's thread was held up.
    """
    frames = load_frames(args.recording, RECORDED_FRAMES)
    print(MCAP_TABLE.head)
    with tempfile.TemporaryDirectory() as folder:
        for name, is_raw in (("compressed", False), ("raw", True)):
            path = Path(folder) / f"{name}.mcap"
            cells = measure_mcap_file(frames, path, is_raw, int(args.seconds * RATE_HZ))
            print(MCAP_TABLE.row(name, *cells), flush=True)


def measure_mcap_file(
    frames: Sequence[RgbdFrame], path: Path, is_raw: bool, count: int
) -> tuple[float, ...]:
    """Record at 30 Hz and read the file again; return the cells of its row."""
    begin_s = time.process_time()
    with FrameRecorder(McapRecordingFile(path, is_raw=is_raw)) as recorder:
        taken_s = send_in_turn(frames, 0, count, recorder.write)
    cpu_ms = 1e3 * (time.process_time() - begin_s) / count
    read_back = len(open_recording(path).frames.pairs)
    size_mb = path.stat().st_size / 1e6
    return (count, read_back, cpu_ms, cpu_ms * RATE_HZ / 10.0, 1e3 * max(taken_s), size_mb)


# How an MCAP file stores images: whether color is raw or JPEG, whether depth is PNG or raw, and the
# compression of its chunks.
MCAP_ENCODINGS = {
    "JPEG, PNG, LZ4 chunks (before)": (False, True, CompressionType.LZ4),
    "JPEG, raw depth, zstd chunks (now)": (False, False, CompressionType.ZSTD),
    "JPEG, raw depth, LZ4 chunks": (False, False, CompressionType.LZ4),
    "raw, LZ4 chunks (--raw)": (True, False, CompressionType.LZ4),
    "raw, zstd chunks": (True, False, CompressionType.ZSTD),
}


def write_encoded(
    frames: Sequence[RgbdFrame],
    path: Path,
    is_raw_color: bool,
    is_png_depth: bool,
    compression: CompressionType,
) -> None:
    """Write frames into an MCAP file, on one thread."""
    with path.open("wb") as file:
        mcap = McapWriter(file, compression)
        mcap.is_for_viewers = not is_png_depth
        writer = FrameWriter(mcap, calibration_of_frame(frames[0]), Decimal(0))
        for frame in frames:
            color = frame.color_bgr
            stored = color if is_raw_color else encode_image(color, ColorFormat.JPEG)
            writer.write_frame(StoredFrame(FrameStamps.from_frame(frame), stored, frame.depth_raw))
        mcap.close()


@RECORDING
@option("--rounds", type=int, default=5, help="of all in turn (default: 5)")
def measure_encodings(args: argparse.Namespace) -> None:
    """CPU time and size of a frame in an MCAP file, by how its images are stored.

    The encodings are measured in turn; the table has the median of the rounds.
    """
    frames = [
        replace(frame, depth_raw=depth_in_mm(frame), depth_factor=1000.0)
        for frame in load_frames(args.recording, RECORDED_FRAMES)
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.mcap"

        def measure(*encoding: Any) -> tuple[float, float]:
            write = partial(write_encoded, frames, path, *encoding)
            _, cpu_ms = measure_cpu_ms(write, time.process_time)
            return cpu_ms / len(frames), path.stat().st_size / len(frames) / 1e3

        cases = {name: partial(measure, *each) for name, each in MCAP_ENCODINGS.items()}
        runs = run_in_turn(cases, args.rounds)
    print(ENCODINGS_TABLE.head)
    for name, measured in runs.items():
        cpu_ms, kilobytes = np.median(measured, axis=0)
        print(ENCODINGS_TABLE.row(name, cpu_ms, kilobytes, kilobytes * RATE_HZ / 1e3))


@option("--seconds", type=float, default=15.0, help="duration of each phase")
def measure_recorder(args: argparse.Namespace) -> None:
    """Cost of the flight recorder: CPU time per frame in both processes.

    `service` is the process of the service, which does nothing else; `worker` is the recorder's
    process. At first it only buffers, then it also records. The frames have noise in color and
    depth.
    """
    frames = list(map(make_noisy_frame, range(8)))
    with (
        tempfile.TemporaryDirectory() as state,
        closing(FlightRecorder(RecorderConfig(), Path(state), {})) as recorder,
    ):
        wait_until(lambda: recorder.is_ready)
        play = partial(play_to_recorder, recorder, frames)
        play(WARM_UP_FRAMES)
        rows = {"remembering": play(int(args.seconds * RATE_HZ))}
        recorder.start_recording("trial")
        rows["recording"] = play(int(args.seconds * RATE_HZ))
        recorder.stop_recording()
    print(f"per frame\n{RECORDER_TABLE.head}")
    for name, cells in rows.items():
        print(RECORDER_TABLE.row(name, *cells))


def play_to_recorder(
    recorder: FlightRecorder, frames: Sequence[RgbdFrame], count: int
) -> tuple[float, ...]:
    """Send frames to a recorder; return the cells of the row of both processes."""
    (worker,) = child_pids_of(os.getpid())
    missed, meter = recorder.dropped, LoadMeter(os.getpid())
    send_in_turn(frames, 0, count, lambda frame: recorder.on_update(make_update(frame)))
    load = meter.read()
    spent_ms = (load.per_frame_ms(count, process) for process in (os.getpid(), worker))
    return (*spent_ms, recorder.dropped - missed)


def make_noisy_frame(seq: int) -> RgbdFrame:
    """Make a slanted wall of blobs, with a Kinect's noise in both images."""
    random = np.random.default_rng(seq)
    blobs = cv2.resize(random.integers(0, 255, (48, 64, 3), np.uint8), (640, 480))
    color = np.clip(blobs + random.normal(0.0, 2.0, blobs.shape), 0, 255).astype(np.uint8)
    wall_mm = np.linspace(1500.0, 3500.0, 640) + random.normal(0.0, 8.0, (480, 640))
    depth = wall_mm.astype(np.uint16)
    depth[random.random(depth.shape) < 0.05] = 0
    camera = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    return RgbdFrame(seq, 0.0, 0.0, color, depth, 1000.0, camera)


VARIANTS: Variants = {
    "frames": measure_publishing,
    "mcap": measure_mcap,
    "encodings": measure_encodings,
    "recorder": measure_recorder,
}
