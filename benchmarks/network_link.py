"""A slow link between this program and processes in a network namespace of their own."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.core import InputError

HOST_ADDRESS, READER_ADDRESS = "10.213.77.1", "10.213.77.2"
NAMESPACE = "kinect-vo-link"
HOST_END, READER_END = "kvo-host", "kvo-reader"


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
