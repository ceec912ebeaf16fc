"""Load of running processes, the arrival of poses, and updates without an odometry."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zenoh

from drivers.camera import RgbdFrame
from drivers.core.folders import cache_folder
from drivers.core.geometry import Array
from drivers.ros_messages.decoding import decode_odometry
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.frame_provider import render_all
from tests.resource_leaks import child_pids_of
from vo_service.terminal import Terminal
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

KEY = "kinect/odom"
RECORDER_STOP_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class ProcessorUse:
    """Processor seconds so far, by process and of the whole machine."""

    by_process: Mapping[int, float]
    stolen_s: float
    total_s: float

    def since(self, before: "ProcessorUse") -> "ProcessorUse":
        """Return the use since `before`; 0 for a process that has ended."""
        spent = {
            process: max(0.0, used_s - before.by_process.get(process, 0.0))
            for process, used_s in self.by_process.items()
        }
        return ProcessorUse(spent, self.stolen_s - before.stolen_s, self.total_s - before.total_s)

    @property
    def steal_percent(self) -> float:
        """Percentage of the machine's time that its host gave to others."""
        return 100.0 * self.stolen_s / self.total_s if self.total_s else 0.0


def measure_processor_use(*processes: int) -> ProcessorUse:
    """Measure the use of processes, with all their threads."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    ticks = [int(field) for field in fields[:8]]  # user nice system idle iowait irq softirq steal
    per_second = 100.0  # USER_HZ
    by_process = {process: _cpu_s(process) for process in processes}
    return ProcessorUse(by_process, ticks[7] / per_second, sum(ticks) / per_second)


def descendants_of(process: int) -> list[int]:
    """Process numbers of all descendants of a process."""
    children = child_pids_of(process)
    return children + [each for child in children for each in descendants_of(child)]


def _cpu_s(process: int) -> float:
    """Processor time of all threads of a process; 0 once it has ended."""
    try:
        # Clock number as in clock_getcpuclockid(3).
        return time.clock_gettime(~process << 3 | 2)
    except OSError:
        return 0.0


def proportional_mb(process: int) -> float:
    """Return the proportional set size of a process, MB."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    (size_kb,) = [int(line.split()[1]) for line in lines if line.startswith("Pss:")]
    return size_kb / 1e3


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
        if self.process.wait(RECORDER_STOP_TIMEOUT_S) != 0:
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
    command = [*prefix, sys.executable, "-m", "benchmarks.service_load", endpoint, str(file)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            if process.stdout.readline() != b"ready\n":
                raise RuntimeError("the subscriber did not start")
            yield ArrivalRecorder(process, file)
        finally:
            process.kill()


def record_arrivals(endpoint: str, file: Path) -> None:
    """Write the arrival of each pose to a file; subscribe until standard input is closed."""
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


def prerender_room(config: SyntheticConfig) -> None:
    """Render the room of a configuration into the cache, for the services started later."""
    print("rendering the room (a minute or two, unless it is cached)", file=sys.stderr)
    progress = Terminal().progress_callback("rendering the room: frame")
    render_all(config, cache_folder() / "sequences", progress).close()


def make_update(frame: RgbdFrame) -> OdometryUpdate:
    """Make the update of a camera at rest that sees the frame, with its number and stamp."""
    identity, covariance = np.eye(4), np.eye(6)
    return OdometryUpdate(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        state=TrackingState.TRACKING,
        reason="",
        epoch=1,
        T_world_camera=identity,
        T_odom_base=identity,
        T_odom_camera=identity,
        pose_covariance=covariance,
        twist=np.zeros(6),
        twist_covariance=covariance,
        frame=frame,
        estimate=Estimate(True, "", identity, identity, covariance),
        stage_ms={},
        latency_s=0.0,
    )


if __name__ == "__main__":  # the subscriber
    record_arrivals(sys.argv[1], Path(sys.argv[2]))
