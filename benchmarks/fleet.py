"""A fleet on one router with TLS and access control: lost poses and latency.

The robots are the service's own publishers, thirty poses per second each, each with its
certificate, several to a process. The router is `kinect-vo router` with
config/zenoh/fleet-router.json5, which has lines for each robot. One reader in a separate process
subscribes to `*/odom`. The latency is from handing a pose to the publisher until the reader has
decoded it. CPU is percent of one core. Exit code 1 if a pose is lost.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.harness import Table, option
from benchmarks.piped_process import print_ready, running_process
from benchmarks.processes import Load, LoadMeter
from benchmarks.subscriber import Arrivals, end_subscriber, running_subscriber
from tests.ports import free_port, is_listening
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.security.tls_network import HOST, VALIDITY_DAYS, TlsNetwork
from tests.vo_service.service_process import KINECT_VO
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import LIVE_QOS, ZenohOutput
from vo_service.tools.certificates import CertificateAuthority

POSES_PER_SECOND = 30
ROBOTS = (sys.executable, "-m", "benchmarks.fleet")
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
    """Create all keys, and write the files for a router at a port of 127.0.0.1."""
    authority, network = CertificateAuthority(folder), TlsNetwork(folder, port, port)
    authority.issue_server_certificate([HOST], VALIDITY_DAYS)
    for name in ("reader", *robots):
        authority.issue_client_certificate(name, VALIDITY_DAYS)
    router = network.file("fleet-router.json5", HOST)
    router.write_text(_add_robots(router.read_text(), robots))
    return FleetFiles(
        router=router,
        reader=network.file("reader-tls.json5", "reader"),
        robots=[network.file("fleet-robot.json5", name) for name in robots],
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


@option("--robots", type=int, default=20)
@option("--seconds", type=int, default=60)
@option("--processes", type=int, default=4, help="processes of the robots (default: 4)")
def main(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    with tempfile.TemporaryDirectory() as folder:
        arrivals, load = run_fleet(Path(folder), args.robots, args.seconds, args.processes)
    received, sent = len(arrivals), args.robots * args.seconds * POSES_PER_SECOND
    router, reader, *robots = load.cpu_s
    row = TABLE.row(
        f"{args.robots} robots",
        *(sent, sent - received, *arrivals.latency_spread_ms),
        *(load.percent(router), load.percent(reader), load.percent(*robots), load.steal_percent),
    )
    print(f"{TABLE.head}\n{row}")
    return 1 if received < sent else 0


def run_fleet(folder: Path, robots: int, seconds: int, processes: int) -> tuple[Arrivals, Load]:
    """Run the fleet once; return what the reader received, and the load of all processes.

    They are in the order of their start: the router, the reader, those of the robots.
    """
    port = free_port()
    files = write_fleet_files(folder, [f"robot{number}" for number in range(1, robots + 1)], port)
    with ExitStack() as stack:
        router = stack.enter_context(running_process(KINECT_VO, "router", files.router))
        wait_until(lambda: is_listening(port), "the router to listen")
        reader = stack.enter_context(running_subscriber(files.reader, "*/odom"))
        publishers = [
            stack.enter_context(running_process(*ROBOTS, str(seconds), *files.robots[n::processes]))
            for n in range(processes)
        ]
        for publisher in publishers:
            publisher.wait_until_ready()  # each robot has discovered the reader
        meter = LoadMeter(*(each.pid for each in (router, reader, *publishers)))
        for publisher in publishers:
            publisher.send("go")
        for publisher in publishers:
            publisher.wait_until_ready()  # all poses are published
        load = meter.read()
        return end_subscriber(reader), load


def publish_poses(seconds: int, files: list[Path]) -> None:
    """Publish as several robots do, 30 poses per second each.

    A robot's name and prefix is the folder of its file. The process prints "ready" once the router
    and the reader are connected, publishes after "go" on standard input, then prints "ready" again.
    """
    robots = [
        ZenohOutput(ZenohConfig(prefix=file.parent.name, config_file=file, listen=()), LIVE_QOS)
        for file in files
    ]
    update = make_update(0)
    if not all(robot.wait_for_subscriber(CONNECT_TIMEOUT_S) for robot in robots):
        raise SystemExit("no reader")
    print_ready()
    sys.stdin.readline()
    begin_s = time.monotonic()
    for turn in range(seconds * POSES_PER_SECOND * len(robots)):
        # The robots publish one after another, evenly over the thirtieth of a second.
        due_s = begin_s + turn / (POSES_PER_SECOND * len(robots))
        time.sleep(max(0.0, due_s - time.monotonic()))
        pose = replace(update, seq=turn // len(robots), stamp_s=time.time())
        robots[turn % len(robots)].on_update(pose)
    time.sleep(DRAIN_S)
    print_ready()
    for robot in robots:
        robot.close()


if __name__ == "__main__":  # some robots of the fleet
    publish_poses(int(sys.argv[1]), list(map(Path, sys.argv[2:])))
