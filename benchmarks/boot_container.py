"""A computer in a container of systemd that boots the installed service, and its poses."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import zenoh

from vo_service import PoseClient
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

SUITE = "bookworm"
PACKAGES = (
    "systemd", "systemd-sysv", "dbus", "udev", "python3-minimal", "libpython3-stdlib",
    "libusb-1.0-0", "libfreenect0.5", "libopenni2-0",
)  # fmt: skip
TOOLS = ("debootstrap", "systemd-nspawn", "nsenter")
CGROUPS = Path("/sys/fs/cgroup")
CONTROLLERS = ("cpu", "cpuacct", "memory", "pids", "devices")
BOOT_TIMEOUT_S = 60.0
# First process of the container. Version 1 control groups are mounted read-only in a container;
# it remounts them, so that limits of processor and memory work.
INIT = """\
#!/bin/sh
for controller in cpu cpuacct memory pids devices; do
    mount -o remount,bind,rw /sys/fs/cgroup/$controller 2>/dev/null
done
exec /lib/systemd/systemd
"""
UNIT = "kinect-vo.service"
RECOVERY_TIMEOUT_S = 120.0
# Kernels are compiled at 30 % of a processor.
INSTALL_TIMEOUT_S = 900.0
# A new version renders its room again.
RENDER_TIMEOUT_S = 900.0
CONFIG = """\
schema = 1
[camera]
source = "synthetic"
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[log]
level = "{level}"
"""


def unsupported_reason() -> str:
    """Reason why no container can run here; "" if one can."""
    if os.geteuid() != 0:
        return "a container needs root"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not installed: apt install debootstrap systemd-container"
    if subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode:
        return "this system does not allow containers"
    return ""


def bootstrap_tree(tree: Path, mirror: str) -> None:
    """Install a small Debian into a folder, unless there is one; takes a minute or two."""
    if not (tree / "complete").exists():
        shutil.rmtree(tree, ignore_errors=True)
        what = ["--variant=minbase", f"--include={','.join(PACKAGES)}", SUITE, str(tree), mirror]
        subprocess.run(["debootstrap", *what], stdout=subprocess.DEVNULL, check=True)
        (tree / "complete").touch()
    init = tree / "root" / "init.sh"
    init.write_text(INIT)
    init.chmod(0o755)


class Container:
    """A running container; it shares the network of this computer."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process
        self._first = 0

    def wait_until_booted(self) -> None:
        """Wait until it has booted. Raises AssertionError if that takes too long."""
        wait_for(lambda: self._find_init_pid() != 0, BOOT_TIMEOUT_S, "the container to start")
        wait_for(
            lambda: self.run("systemctl", "is-active", "multi-user.target").strip() == "active",
            BOOT_TIMEOUT_S,
            "the container to boot",
        )

    def run(self, *command: str, limit_s: float = 60.0, check: bool = False) -> str:
        """Run a command in it and return its output and errors.

        Raises:
            AssertionError: With `check`, the command fails.
        """
        namespaces = ["-m", "-u", "-i", "-p", "-C", "--root", "--wd"]
        result = subprocess.run(
            ["nsenter", "-t", str(self._first), *namespaces, "--", *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=limit_s,
            check=False,
        )
        assert not check or result.returncode == 0, f"{' '.join(command)}: {result.stdout.strip()}"
        return result.stdout

    def shell(self, script: str) -> str:
        """Run a shell script in it."""
        return self.run("sh", "-c", script)

    def power_off(self) -> None:
        """Shut it down; kill it if that takes too long."""
        if self._first:
            self.run("systemctl", "poweroff", "--force")
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            # The container ends with its first process, but not with systemd-nspawn.
            for process in filter(None, (self._first, self._process.pid)):
                os.kill(process, signal.SIGKILL)
            self._process.wait()

    def _find_init_pid(self) -> int:
        """Process number, on this computer, of its first process; 0 if there is none yet."""
        assert self._process.poll() is None, "systemd-nspawn has ended"
        lists = Path(f"/proc/{self._process.pid}/task").glob("*/children")
        children = [int(child) for each in lists for child in each.read_text().split()]
        self._first = next((child for child in children if _is_init(child)), 0)
        return self._first


def _is_init(process: int) -> bool:
    """Whether a process is number 1 in a container, and no short-lived child of systemd-nspawn."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    return re.search(r"^NSpid:\t\d+\t1$", status, re.MULTILINE) is not None


@contextmanager
def running_container(tree: Path, shared: Sequence[Path], log: Path) -> Iterator[Container]:
    """Run the Debian in `tree`, with some folders of this computer mounted read-only.

    Args:
        log: File for its console.
    """
    command = [
        "systemd-nspawn",
        "--quiet",
        f"--directory={tree}",
        f"--machine=kinect-vo-{os.getpid()}",
    ]
    command += [f"--bind-ro={folder}" for folder in shared]
    command += ["--console=pipe", "--kill-signal=SIGRTMIN+3"]
    if not Path("/run/systemd/system").is_dir():
        command += ["--register=no", "--keep-unit"]
    groups = _create_cgroups()
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [*command, "/root/init.sh"],
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=stream,
            preexec_fn=lambda: _enter_cgroups(groups),
        )
    container = Container(process)
    try:
        container.wait_until_booted()
        yield container
    finally:
        container.power_off()
        for group in groups:
            _remove_cgroup(group)


def wait_for(condition: Callable[[], bool], limit_s: float, what: str) -> float:
    """Wait for a condition; return the seconds that took. Raises AssertionError after `limit_s`."""
    begin_s = time.monotonic()
    while not condition():
        assert time.monotonic() - begin_s < limit_s, f"waited {limit_s:.0f} s in vain for {what}"
        time.sleep(0.2)
    return time.monotonic() - begin_s


def _create_cgroups() -> list[Path]:
    """Create version 1 control groups for the container; none on a system with version 2."""
    groups = []
    for controller in CONTROLLERS:
        if (CGROUPS / controller / "cgroup.procs").exists():
            group = CGROUPS / controller / f"kinect-vo-{os.getpid()}"
            group.mkdir(exist_ok=True)
            groups.append(group)
    return groups


def _enter_cgroups(groups: Sequence[Path]) -> None:
    for group in groups:
        (group / "cgroup.procs").write_text(str(os.getpid()))


def _remove_cgroup(group: Path) -> None:
    for folder in sorted(group.rglob("*/"), reverse=True):
        with suppress(OSError):
            folder.rmdir()
    with suppress(OSError):
        group.rmdir()


class PoseCounter:
    """Counts the poses of a service."""

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._count = 0
        self._subscriber = session.declare_subscriber(f"{prefix}/odom", self._on_pose)

    def wait_for_poses(self, count: int, limit_s: float) -> float:
        """Wait for `count` more poses; return the seconds. Raises AssertionError when too late."""
        before = self._count
        return wait_for(lambda: self._count >= before + count, limit_s, f"{count} poses")

    def measure_pose_rate(self, seconds: float) -> float:
        """Measure the poses per second over `seconds`."""
        before = self._count
        time.sleep(seconds)
        return (self._count - before) / seconds

    def _on_pose(self, sample: zenoh.Sample) -> None:
        self._count += 1


@contextmanager
def counting_poses(port: int, prefix: str = "kinect") -> Iterator[PoseCounter]:
    """Count the poses of the service on a port of this computer."""
    config = ZenohConfig(listen=(), connect=(f"tcp/127.0.0.1:{port}",))
    with open_session(config) as session:
        yield PoseCounter(session, prefix)


@dataclass(frozen=True)
class BootedComputer:
    """A container with the service.

    Attributes:
        container: The running container.
        tree: Its file system.
        command: The `kinect-vo` of the checkout.
        counter: A subscriber outside the container.
        port: Port of the service.
    """

    container: Container
    tree: Path
    command: str
    counter: PoseCounter
    port: int

    def client(self) -> PoseClient:
        """A client outside the container."""
        return PoseClient(connect=f"tcp/127.0.0.1:{self.port}")

    def kinect_vo(self, *arguments: str) -> str:
        """Run the checkout's command; return its output. Raises AssertionError if it fails."""
        command = (self.command, *arguments)
        return self.container.run(*command, limit_s=INSTALL_TIMEOUT_S, check=True)

    def systemctl(self, *arguments: str) -> None:
        """Run systemctl. Raises AssertionError if it fails."""
        self.container.run("systemctl", *arguments, limit_s=INSTALL_TIMEOUT_S, check=True)

    def unit_property(self, name: str) -> str:
        """Read a property of the service from systemd."""
        return self.container.run("systemctl", "show", UNIT, "-p", name, "--value").strip()

    def set_cpu_quota(self, text: str) -> None:
        """Set the processor quota of the service; "" removes it."""
        self.systemctl("set-property", "--runtime", UNIT, f"CPUQuota={text}")

    def write_config(self, level: str = "info") -> None:
        """Write the configuration; it is valid if `level` is a log level."""
        folder = self.tree / "etc" / "kinect-vo"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "kinect.toml").write_text(self.config_text(level))

    def config_text(self, level: str = "info") -> str:
        """Configuration of the synthetic camera on the port."""
        return CONFIG.format(port=self.port, level=level)

    def journal_entries(self) -> list[dict[str, str]]:
        """Read the journal of the service."""
        lines = self.container.run("journalctl", "-u", UNIT, "-o", "json", "--no-pager")
        return [json.loads(line) for line in lines.splitlines() if line.startswith("{")]
