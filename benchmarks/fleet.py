"""A fleet on one router with TLS and access control: lost poses and latency.

    python -m benchmarks fleet [--robots 20] [--seconds 60] [--processes 4]

The robots are the service's own publishers, thirty poses per second each, each with its
certificate, several to a process. The router is `kinect-vo router` with
config/zenoh/fleet-router.json5, which has lines for each robot. One reader in a separate process
subscribes to `*/odom`. The latency is from handing a pose to the publisher until the reader has
decoded it. CPU is percent of one core. Exit code 1 if a pose is lost.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.harness import Table, option
from benchmarks.service_load import make_update, measure_processor_use
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.ros_messages.decoding import decode_odometry
from tests.ports import free_port
from tests.vo_service.service_process import KINECT_VO
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import LIVE_QOS, ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.tools.certificates import CertificateAuthority

TEMPLATES = Path(__file__).parents[1] / "config" / "zenoh"
HOST = "127.0.0.1"
VALIDITY_DAYS = 2
POSES_PER_SECOND = 30
ROUTER = (KINECT_VO, "router")
ROBOTS = (sys.executable, "-m", "benchmarks.fleet", "robots")
READER = (sys.executable, "-m", "benchmarks.fleet", "reader")
TABLE = Table(
    *(10, "poses:8d", "lost:6d", "p50 ms:8.2f", "p99 ms:8.2f", "max ms:8.1f"),
    *("router CPU %:14.1f", "reader CPU %:14.1f", "robots CPU %:14.1f", "steal %:9.1f"),
)
CONNECT_TIMEOUT_S = 30.0
DRAIN_S = 1.0


@dataclass(frozen=True)
class FleetFiles:
    """Zenoh files of the router, the reader and the robots; each is beside its keys."""

    router: Path
    reader: Path
    robots: Sequence[Path]


def write_fleet_files(folder: Path, robots: Sequence[str], port: int) -> FleetFiles:
    """Create all keys, and write the files for a router at a port of 127.0.0.1.

    Args:
        folder: New folder for the files.
        robots: Number of robots.
        port: TCP port of the router.
    """
    authority = CertificateAuthority(folder)
    router = authority.issue_server_certificate([HOST], VALIDITY_DAYS)
    reader = authority.issue_client_certificate("reader", VALIDITY_DAYS)
    homes = [authority.issue_client_certificate(name, VALIDITY_DAYS) for name in robots]
    text = (TEMPLATES / "fleet-router.json5").read_text().replace("0.0.0.0:7447", f"{HOST}:{port}")
    at_router = ("robot1.local:7451", "router.local:7447")
    return FleetFiles(
        router=_write(router / "router.json5", _add_robots(text, robots)),
        reader=_write(reader / "reader.json5", _redirect("reader-tls.json5", at_router, port)),
        robots=[
            _write(home / "robot.json5", _redirect("fleet-robot.json5", at_router, port))
            for home in homes
        ],
    )


def _add_robots(text: str, robots: Sequence[str]) -> str:
    """Repeat each line for robot1 in the router's file for each robot."""
    lines = []
    for line in text.splitlines():
        if line.lstrip().startswith(('{ id: "robot1"', '{ subjects: ["robot1"]')):
            lines += [line.replace("robot1", name) for name in robots]
        elif '"robot2"' not in line:
            lines.append(line)
    return "\n".join(lines)


def _redirect(name: str, addresses: Sequence[str], port: int) -> str:
    """Change a provided profile to connect to our router and not to listen."""
    text = (TEMPLATES / name).read_text().replace('"tcp/127.0.0.1:7450"', "")
    for address in addresses:
        text = text.replace(address, f"{HOST}:{port}")
    return text


def _write(file: Path, text: str) -> Path:
    file.write_text(text)
    return file


@dataclass(frozen=True)
class FleetResult:
    """Poses and latencies of the reader, and processor use."""

    sent: int
    latency_ms: Array
    router_percent: float
    reader_percent: float
    robots_percent: float
    steal_percent: float

    @property
    def lost_poses(self) -> int:
        """Number of poses that were not received."""
        return self.sent - len(self.latency_ms)


OPTIONS = (
    option("--robots", type=int, default=20),
    option("--seconds", type=int, default=60),
    option("--processes", type=int, default=4, help="processes of the robots (default: 4)"),
)


def main(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    with tempfile.TemporaryDirectory() as folder:
        outcome = _measure(Path(folder), args.robots, args.seconds, args.processes)
    print(f"{TABLE.head}\n{_format_row(outcome, args.robots)}")
    return 1 if outcome.lost_poses else 0


def _measure(folder: Path, robots: int, seconds: int, processes: int) -> FleetResult:
    """Run the fleet once."""
    port = free_port()
    files = write_fleet_files(folder, [f"robot{number}" for number in range(1, robots + 1)], port)
    shares = [[str(file) for file in files.robots[start::processes]] for start in range(processes)]
    with ExitStack() as stack:
        router = stack.enter_context(_running_process(*ROUTER, str(files.router)))
        _wait_until_listening(port, router)
        reader = stack.enter_context(_running_process(*READER, str(files.reader)))
        _wait_until_ready(reader)
        robot_processes = [
            stack.enter_context(_running_process(*ROBOTS, str(seconds), *share)) for share in shares
        ]
        for process in robot_processes:
            _wait_until_ready(process)  # each robot has discovered the reader
        numbers = [process.pid for process in (router, reader, *robot_processes)]
        before, begin_s = measure_processor_use(*numbers), time.monotonic()
        for process in robot_processes:
            _send_command(process, "go")
        for process in robot_processes:
            _wait_until_ready(process)  # all poses are published
        use, taken_s = measure_processor_use(*numbers).since(before), time.monotonic() - begin_s
        latency_ms = np.array(json.loads(_send_command(reader, "end")))
    percent = [100 * use.by_process[number] / taken_s for number in numbers]
    return FleetResult(
        sent=robots * seconds * POSES_PER_SECOND,
        latency_ms=latency_ms,
        router_percent=percent[0],
        reader_percent=percent[1],
        robots_percent=sum(percent[2:]),
        steal_percent=use.steal_percent,
    )


def _format_row(outcome: FleetResult, robots: int) -> str:
    """The one row of the table."""
    ms = outcome.latency_ms
    p50_ms, p99_ms = np.percentile(ms, (50, 99)) if len(ms) else (0.0, 0.0)
    return TABLE.row(
        f"{robots} robots",
        *(outcome.sent, outcome.lost_poses, p50_ms, p99_ms, ms.max(initial=0.0)),
        *(outcome.router_percent, outcome.reader_percent, outcome.robots_percent),
        outcome.steal_percent,
    )


@contextmanager
def _running_process(*command: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a process of the fleet; kill it at the end."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _send_command(process: "subprocess.Popen[str]", command: str) -> str:
    """Send a process a command; return its output after "end"."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{command}\n")
    process.stdin.flush()
    return process.stdout.readline() if command == "end" else ""


def _wait_until_ready(process: "subprocess.Popen[str]") -> None:
    assert process.stdout is not None
    if process.stdout.readline() != "ready\n":
        raise RuntimeError(f"{process.args!r} has failed")


def _wait_until_listening(port: int, router: "subprocess.Popen[str]") -> None:
    while f":{port:04X} 00000000:0000 0A" not in Path("/proc/net/tcp").read_text():
        if router.poll() is not None:
            raise RuntimeError("the router has failed")
        time.sleep(0.05)


def read_poses(file: Path) -> None:
    """Measure the age of each pose of each robot with one wildcard subscriber.

    It prints "ready" once it subscribes. After "end" on standard input it prints the latencies in
    milliseconds as a JSON list.
    """
    latency_ms: dict[tuple[str, int], float] = {}

    def take(sample: zenoh.Sample) -> None:
        stamp_s = decode_odometry(sample.payload.to_bytes()).stamp_s
        received_s = time.monotonic()
        attachment = sample.attachment
        assert attachment is not None
        seq = json.loads(attachment.to_bytes())["seq"]
        latency_ms.setdefault((str(sample.key_expr), seq), 1e3 * (received_s - stamp_s))

    config = ZenohConfig(config_file=file, listen=())
    with open_session(config) as session, session.declare_subscriber("*/odom", take):
        print("ready", flush=True)
        sys.stdin.readline()
    print(json.dumps(list(latency_ms.values())), flush=True)


def publish_poses(seconds: int, files: list[Path]) -> None:
    """Publish as several robots do, 30 poses per second each.

    A robot's name and prefix is the folder of its file. The process prints "ready" once the router
    and the reader are connected, publishes after "go" on standard input, then prints "ready" again.
    """
    robots = [
        ZenohOutput(ZenohConfig(prefix=file.parent.name, config_file=file, listen=()), LIVE_QOS)
        for file in files
    ]
    image, camera = np.zeros((2, 2), np.uint16), PinholeCamera(2, 2, 1.0, 1.0, 0.5, 0.5)
    update = make_update(RgbdFrame(0, 0.0, 0.0, np.zeros((2, 2, 3), np.uint8), image, 1e3, camera))
    if not all(robot.wait_for_subscriber(CONNECT_TIMEOUT_S) for robot in robots):
        raise SystemExit("no reader")
    print("ready", flush=True)
    sys.stdin.readline()
    begin_s = time.monotonic()
    for turn in range(seconds * POSES_PER_SECOND * len(robots)):
        # The robots publish one after another, evenly over the thirtieth of a second.
        due_s = begin_s + turn / (POSES_PER_SECOND * len(robots))
        time.sleep(max(0.0, due_s - time.monotonic()))
        # The stamp is on CLOCK_MONOTONIC, which the reader compares.
        pose = replace(update, seq=turn // len(robots), stamp_s=time.monotonic())
        robots[turn % len(robots)].on_update(pose)
    time.sleep(DRAIN_S)
    print("ready", flush=True)
    for robot in robots:
        robot.close()


if __name__ == "__main__":  # a process of the fleet
    if sys.argv[1] == "reader":
        read_poses(Path(sys.argv[2]))
    else:
        publish_poses(int(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
