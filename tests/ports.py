"""Free ports for tests, and the kernel's tables of open sockets."""

import os
import random
import socket
import struct
from collections.abc import Iterator
from functools import cache
from itertools import cycle
from pathlib import Path

from tests.resource_leaks import open_files

MIN_PORT = 20000
# Number of pytest workers with separate ports.
MAX_WORKERS = 4


def free_port() -> int:
    """Return a free port that no other test gets before this test uses it.

    It is outside the kernel's range for outgoing connections, which parallel tests may open at any
    time. Each pytest worker has its own ports, and returns one again only after all others.
    """
    return next(port for port in _ports() if _is_free(port))


def is_listening(port: int) -> bool:
    """Whether a process listens on a port of 127.0.0.1, without connecting to it."""
    address = f"0100007F:{port:04X}"
    return any(row[1] == address and row[3] == "0A" for row in open_sockets("tcp"))


def listening_addresses(pid: int) -> set[str]:
    """Return the addresses that a process listens on, such as "127.0.0.1"."""
    inodes = {file[8:-1] for file in open_files(pid) if file.startswith("socket:[")}
    addresses = set()
    for fields in open_sockets("tcp", "tcp6"):
        if fields[3] == "0A" and fields[9] in inodes:
            words = bytes.fromhex(fields[1].split(":")[0])
            count = len(words) // 4
            network_order = struct.pack(f">{count}I", *struct.unpack(f"<{count}I", words))
            family = socket.AF_INET if count == 1 else socket.AF_INET6
            addresses.add(socket.inet_ntop(family, network_order))
    return addresses


def open_sockets(*protocols: str) -> list[list[str]]:
    """Return the rows of these protocols' sockets; a kernel without IPv6 has no such table."""
    tables = [Path("/proc/net", protocol) for protocol in protocols]
    texts = [table.read_text() for table in tables if table.exists()]
    return [line.split() for text in texts for line in text.splitlines()[1:]]


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@cache
def _ports() -> Iterator[int]:
    """Ports of this worker in random order, so that other test runs begin with others."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    outgoing = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    ports = list(range(MIN_PORT + worker % MAX_WORKERS, outgoing, MAX_WORKERS))
    random.SystemRandom().shuffle(ports)
    return cycle(ports)
