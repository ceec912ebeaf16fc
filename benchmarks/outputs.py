"""Cost of the outputs of frames: Zenoh, a recording into MCAP, its encodings, the flight recorder.

    python -m benchmarks outputs frames RECORDING [--seconds 20] [--case NAME]
    python -m benchmarks outputs mcap RECORDING [--seconds 60]
    python -m benchmarks outputs encodings RECORDING [--rounds 5]
    python -m benchmarks outputs recorder [RECORDING] [--seconds 15]

Frames of RECORDING are sent from memory 30 times a second, without odometry. Times are
milliseconds; CPU is per frame.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from mcap.writer import CompressionType

from benchmarks.harness import RECORDING, Variants, format_table, option
from benchmarks.service_load import make_update, measure_processor_use, running_recorder
from drivers.bag.bag_writer import McapWriter
from drivers.bag.frame_writer import FrameWriter
from drivers.bag.mcap_recording_file import McapRecordingFile
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import T_BODY_CAMERA
from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from drivers.recording.frame_encoding import FrameStamps, calibration_of_frame
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.recording_sink import StoredFrame
from tests.ports import free_port
from tests.resource_leaks import child_pids_of, resident_memory_kb
from vo_service.config_tables import FramesConfig, RecorderConfig, ZenohConfig
from vo_service.outputs.frames.frame_messages import depth_in_mm
from vo_service.outputs.frames.output import FrameOutput, FrameOutputConfig
from vo_service.outputs.recorder.client import FlightRecorder
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints
from vo_service.types.commands import CommandError
from vo_service.types.odometry_update import OdometryUpdate

RATE_HZ = 30.0
Item = TypeVar("Item", RgbdFrame, OdometryUpdate)
# Frames of the recording that are sent in turn.
SOURCE_FRAMES = {"frames": 40, "mcap": 100, "recorder": 60}
WARM_UP_FRAMES = 60
RAW, COMPRESSED = ("color/image", "depth/image"), ("color/compressed", "depth/compressed")
HOST_ADDRESS, READER_ADDRESS = "10.213.77.1", "10.213.77.2"
NAMESPACE = "kinect-vo-link"
HOST_END, READER_END = "kvo-host", "kvo-reader"


def load_frames(recording: Path, count: int) -> list[RgbdFrame]:
    """The first frames of a recording."""
    with RecordingCamera(recording) as camera:
        return list(islice(camera, count))


def send_in_turn(
    items: Sequence[Item], first: int, count: int, send: Callable[[Item], None]
) -> list[float]:
    """Send frames or updates in turn at the frame rate, with new numbers and stamps.

    Args:
        items: The frames or updates.
        first: Number of the first one.
        count: How many to send.
        send: What sends one.

    Returns:
        Seconds that each call took.
    """
    begin_s, taken_s = time.monotonic(), []
    for i in range(count):
        time.sleep(max(0.0, begin_s + i / RATE_HZ - time.monotonic()))
        item = replace(items[(first + i) % len(items)], seq=first + i, stamp_s=time.time())
        started_s = time.perf_counter()
        send(item)
        taken_s.append(time.perf_counter() - started_s)
    # The next call goes on at the same rate.
    time.sleep(max(0.0, begin_s + count / RATE_HZ - time.monotonic()))
    return taken_s


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
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.zenoh_config import MAX_FRAME_MESSAGE_BYTES
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


FRAMES_OPTIONS = (
    RECORDING,
    option("--seconds", type=float, default=20.0, help="length of a case"),
    option("--case", choices=CASES, action="append", help="only this case"),
)


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
    updates = list(map(make_update, load_frames(args.recording, SOURCE_FRAMES["frames"])))
    count = int(args.seconds * RATE_HZ)
    rows = {name: measure_case(CASES[name], updates, count) for name in names}
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


def measure_case(case: Case, updates: Sequence[OdometryUpdate], count: int) -> list[str]:
    """Run one case; return the cells of its row."""
    config = FrameOutputConfig("kinect", FramesConfig(), T_BODY_CAMERA)
    with ExitStack() as stack:
        address, prefix = "127.0.0.1", list[str]()
        if case.link_mbit_s:
            address, prefix = HOST_ADDRESS, stack.enter_context(network_link(case.link_mbit_s))
        endpoint = f"tcp/{address}:{free_port()}"
        output = stack.enter_context(closing(FrameOutput(config)))
        extras = ExtraEndpoints(on_session=output.declare, on_pose=output.queue)
        poses = stack.enter_context(
            closing(ZenohOutput(ZenohConfig(listen=(endpoint,)), extra_endpoints=extras))
        )
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arrivals = stack.enter_context(running_recorder(endpoint, folder / "poses.npz", prefix))
        readers = [start_reader(stack, prefix, endpoint, topics) for topics in case.readers]
        send_in_turn(updates, 0, WARM_UP_FRAMES, poses.on_update)
        for reader in readers if case.is_stopped else ():
            reader.send_signal(signal.SIGSTOP)
        begin_stamp_s, begin_s, cpu_s = time.time(), time.monotonic(), time.process_time()
        taken_s = send_in_turn(updates, WARM_UP_FRAMES, count // 2, poses.on_update)
        half_kb = resident_memory_kb(os.getpid())
        first = WARM_UP_FRAMES + count // 2
        send_in_turn(updates, first, count - count // 2, poses.on_update)
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
    costs = [
        f"{1e3 * np.mean(taken_s):.3f}",
        f"{cpu_ms:.2f}",
        f"{max(reader_ms):.2f}",
        f"{growth_mb:.1f}",
    ]
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


MCAP_OPTIONS = (
    RECORDING,
    option("--seconds", type=float, default=60.0, help="duration (default: 60)"),
)


def measure_mcap(args: argparse.Namespace) -> None:
    """Cost and completeness of a recording into MCAP, with color as JPEG, then raw.

    The table shows the frames that were written and read back, the CPU time per frame, its share of
    one core at 30 Hz, and the longest time that the camera's thread was held up.
    """
    frames = load_frames(args.recording, SOURCE_FRAMES["mcap"])
    with tempfile.TemporaryDirectory() as folder:
        rows = {
            name: measure_mcap_file(frames, Path(folder) / f"{name}.mcap", is_raw, args.seconds)
            for name, is_raw in (("compressed", False), ("raw", True))
        }
    headings = ["sent", "read back", "CPU ms", "core %", "longest write ms", "MB"]
    print(format_table(headings, rows))


def measure_mcap_file(
    frames: Sequence[RgbdFrame], path: Path, is_raw: bool, seconds: float
) -> list[str]:
    """Record at 30 Hz and read the file again; return the cells of its row."""
    count, begin_s = int(seconds * RATE_HZ), time.process_time()
    with FrameRecorder(McapRecordingFile(path, is_raw=is_raw)) as recorder:
        taken_s = send_in_turn(frames, 0, count, recorder.write)
    cpu_ms = 1e3 * (time.process_time() - begin_s) / count
    read_back = len(open_recording(path).frames.pairs)
    return [
        *(f"{count}", f"{read_back}", f"{cpu_ms:.1f}", f"{cpu_ms * RATE_HZ / 10.0:.0f}"),
        *(f"{1e3 * max(taken_s):.0f}", f"{path.stat().st_size / 1e6:.0f}"),
    ]


@dataclass(frozen=True)
class McapEncoding:
    """How an MCAP file stores images: color as JPEG or raw, depth as PNG or raw, and its chunks."""

    is_raw_color: bool
    is_png_depth: bool
    compression: CompressionType

    def write(self, frames: Sequence[RgbdFrame], path: Path) -> None:
        """Write the frames on one thread."""
        with path.open("wb") as file:
            mcap = McapWriter(file, self.compression)
            mcap.is_for_viewers = not self.is_png_depth
            writer = FrameWriter(mcap, calibration_of_frame(frames[0]), Decimal(0))
            for frame in frames:
                color = frame.color_bgr
                stored = color if self.is_raw_color else encode_image(color, ColorFormat.JPEG)
                stamps = FrameStamps.from_frame(frame)
                writer.write_frame(StoredFrame(stamps, stored, frame.depth_raw))
            mcap.close()


MCAP_ENCODINGS = {
    "JPEG, PNG, LZ4 chunks (before)": McapEncoding(False, True, CompressionType.LZ4),
    "JPEG, raw depth, zstd chunks (now)": McapEncoding(False, False, CompressionType.ZSTD),
    "JPEG, raw depth, LZ4 chunks": McapEncoding(False, False, CompressionType.LZ4),
    "raw, LZ4 chunks (--raw)": McapEncoding(True, False, CompressionType.LZ4),
    "raw, zstd chunks": McapEncoding(True, False, CompressionType.ZSTD),
}


ENCODINGS_OPTIONS = (
    RECORDING,
    option("--rounds", type=int, default=5, help="of all in turn (default: 5)"),
)


def measure_encodings(args: argparse.Namespace) -> None:
    """CPU time and size of a frame in an MCAP file, by how its images are stored.

    The encodings are measured in turn; the table has the median of the rounds.
    """
    frames = [
        replace(frame, depth_raw=depth_in_mm(frame), depth_factor=1000.0)
        for frame in load_frames(args.recording, SOURCE_FRAMES["mcap"])
    ]
    cpu_ms: dict[str, list[float]] = {name: [] for name in MCAP_ENCODINGS}
    kilobytes: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.mcap"
        for _ in range(args.rounds):
            for name, encoding in MCAP_ENCODINGS.items():
                begin_s = time.process_time()
                encoding.write(frames, path)
                cpu_ms[name].append(1e3 * (time.process_time() - begin_s) / len(frames))
                kilobytes[name] = path.stat().st_size / len(frames) / 1e3
    rows = {
        name: [f"{np.median(cpu_ms[name]):.1f}", f"{size:.0f}", f"{size * RATE_HZ / 1e3:.1f}"]
        for name, size in kilobytes.items()
    }
    print(format_table(["CPU ms", "kB a frame", "MB/s"], rows))


RECORDER_OPTIONS = (
    option("recording", metavar="RECORDING", type=Path, nargs="?", help="source of the frames"),
    option("--seconds", type=float, default=15.0, help="duration of each phase"),
)


def measure_recorder(args: argparse.Namespace) -> None:
    """Cost of the flight recorder: CPU time per frame in both processes, memory, and an incident.

    `service` is the process of the service, which does nothing else; `worker` is the recorder's
    process. There are three phases: it only buffers; it also records; it writes an incident at the
    beginning. Memory is that at the end of a phase, without the ring, which both processes share.
    Without RECORDING the frames have noise in color and depth.
    """
    frames = list(map(make_noisy_frame, range(8)))
    if args.recording is not None:
        frames = load_frames(args.recording, SOURCE_FRAMES["recorder"])
    with tempfile.TemporaryDirectory() as state:
        recorder = FlightRecorder(RecorderConfig(), Path(state), {})
        try:
            while not recorder.is_ready:
                time.sleep(0.1)
            player = RecorderPlayer(recorder, frames)
            player.play(6.0)
            rows = {"remembering": player.play(args.seconds)}
            recorder.start_recording("trial")
            rows["recording"] = player.play(args.seconds)
            recorder.stop_recording()
            begin_s = time.time()
            folder = Path(_save_incident(recorder))
            rows["with an incident"] = player.play(args.seconds)
            incident_s = folder.stat().st_ctime - begin_s
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        finally:
            recorder.close()
    headings = ("service ms", "worker ms", "missed", "MB service", "MB worker", "MB ring")
    print(f"per frame\n{format_table(headings, rows)}")
    print(f"an incident took {incident_s:.1f} s and {size / 1e6:.0f} MB of disk")


class RecorderPlayer:
    """Sends frames to a recorder, and measures both processes."""

    def __init__(self, recorder: FlightRecorder, frames: Sequence[RgbdFrame]) -> None:
        self._recorder, self._frames, self._sent = recorder, frames, 0
        (worker,) = child_pids_of(os.getpid())
        self._processes = (os.getpid(), worker)

    def play(self, seconds: float) -> list[str]:
        """Measure a phase; return the cells of its row."""
        count, missed = int(seconds * RATE_HZ), self._recorder.dropped
        before = measure_processor_use(*self._processes)
        send_in_turn(
            self._frames,
            self._sent,
            count,
            lambda frame: self._recorder.on_update(make_update(frame)),
        )
        self._sent += count
        used = measure_processor_use(*self._processes).since(before)
        return [
            *(f"{1e3 * used.by_process[each] / count:.2f}" for each in self._processes),
            f"{self._recorder.dropped - missed}",
            *(f"{_private_memory_mb(each):.0f}" for each in self._processes),
            f"{_memory_mb(os.getpid(), 'RssShmem'):.0f}",
        ]


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


def _save_incident(recorder: FlightRecorder) -> str:
    while True:
        try:
            return recorder.save("benchmark")
        except CommandError:
            time.sleep(0.1)


def _private_memory_mb(process: int) -> float:
    """Resident memory of a process, without shared memory."""
    return _memory_mb(process, "RssAnon") + _memory_mb(process, "RssFile")


def _memory_mb(process: int, kind: str) -> float:
    match = re.search(rf"{kind}:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    assert match is not None
    return int(match[1]) / 1e3


VARIANTS: Variants = {
    "frames": (FRAMES_OPTIONS, measure_publishing),
    "mcap": (MCAP_OPTIONS, measure_mcap),
    "encodings": (ENCODINGS_OPTIONS, measure_encodings),
    "recorder": (RECORDER_OPTIONS, measure_recorder),
}
