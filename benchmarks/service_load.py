"""Load of a running service: processor time, a processor limit, and the arrival of its poses."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import zenoh

from drivers.core.geometry import Array
from tests.resource_leaks import child_pids_of
from vo_service.ros_messages.decoding import decode_odometry

PERIOD_US = 100_000  # as systemd
STOP_TIMEOUT_S = 10.0


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


@contextmanager
def limit_processor(percent: float) -> Iterator[Callable[[Iterable[int]], None]]:
    """Create a control group whose processes together get `percent` of one processor.

    At the end its processes return to the parent group.

    Yields:
        A function that moves processes into the group; their later children are in it too.

    Raises:
        RuntimeError: Control groups cannot be created.
    """
    parent, write_limit = _find_cpu_cgroup()
    try:
        group = Path(mkdtemp(prefix="slow-machine-", dir=parent))
        write_limit(group, round(percent / 100.0 * PERIOD_US))
    except OSError as error:
        raise RuntimeError(
            f"{parent}: cannot create a control group: {error}; run as root"
        ) from error
    try:
        yield lambda processes: _move(processes, group)
    finally:
        _remove_cgroup(group, parent)


def _find_cpu_cgroup() -> tuple[Path, Callable[[Path, int], None]]:
    """Return the top group of the cpu controller, and the function that writes a limit."""
    first = Path("/sys/fs/cgroup/cpu")
    if (first / "cpu.shares").exists():
        return first, _write_cgroup_v1
    return Path("/sys/fs/cgroup"), _write_cgroup_v2


def _write_cgroup_v1(group: Path, quota_us: int) -> None:
    (group / "cpu.cfs_period_us").write_text(str(PERIOD_US))
    (group / "cpu.cfs_quota_us").write_text(str(quota_us))


def _write_cgroup_v2(group: Path, quota_us: int) -> None:
    (group / "cpu.max").write_text(f"{quota_us} {PERIOD_US}")


def _remove_cgroup(group: Path, parent: Path) -> None:
    """Remove a group; retry, because ending processes hold it for a moment."""
    deadline_s = time.monotonic() + STOP_TIMEOUT_S
    while True:
        _move(map(int, (group / "cgroup.procs").read_text().split()), parent)
        try:
            group.rmdir()
        except OSError:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.1)
        else:
            return


def _move(processes: Iterable[int], group: Path) -> None:
    for process in processes:
        try:
            (group / "cgroup.procs").write_text(str(process))
        except ProcessLookupError:
            continue  # the process has ended


KEY = "kinect/odom"
RECORDER_STOP_TIMEOUT_S = 20.0


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


if __name__ == "__main__":  # the subscriber
    record_arrivals(sys.argv[1], Path(sys.argv[2]))
