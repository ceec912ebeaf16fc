"""Ports of 127.0.0.1: one that is free for a test, and whether anyone listens on one."""

import os
import random
import socket
from collections.abc import Iterator
from functools import cache
from itertools import cycle
from pathlib import Path

MIN_PORT = 20000
# So many workers have ports of their own.
MAX_WORKERS = 4


def free_port() -> int:
    """A port that nobody has, and that nobody else is given before the test uses it.

    Not from the range that the kernel takes ports of outgoing connections from, which a test that
    runs beside this one may open at any time. Each of pytest's workers has ports of its own, and
    gives none again before it has given all.
    """
    return next(port for port in _ports() if _is_free(port))


def is_listening(port: int) -> bool:
    """True if someone listens on a port of 127.0.0.1, without a knock on it."""
    here = f"0100007F:{port:04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return any(row[1] == here and row[3] == "0A" for row in rows)


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@cache
def _ports() -> Iterator[int]:
    """Of this worker, in no order: another run of the tests begins with others."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    outgoing = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    ports = list(range(MIN_PORT + worker % MAX_WORKERS, outgoing, MAX_WORKERS))
    random.SystemRandom().shuffle(ports)
    return cycle(ports)
