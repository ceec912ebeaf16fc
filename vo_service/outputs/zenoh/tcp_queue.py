"""How much of what was sent over TCP has not been read yet, as Linux sees it."""

from collections.abc import Iterable, Iterator
from pathlib import Path

PROC_TCP_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

PortPair = tuple[int, int]


def queued_bytes(connections: Iterable[PortPair]) -> int:
    """Bytes on their way over connections given as (our port, their port).

    Counts what their kernel has not acknowledged and, where they run on this host, what it holds
    and they have not read.
    """
    wanted = set(connections)
    total = 0
    for ours, theirs, sending, received in _sockets():
        if (ours, theirs) in wanted:
            total += sending
        elif (theirs, ours) in wanted:
            total += received
    return total


def _sockets() -> Iterator[tuple[int, int, int, int]]:
    """Local port, remote port, bytes in the send queue, bytes in the receive queue."""
    for table in PROC_TCP_TABLES:
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for line in lines:
            _, local, remote, _, queues = line.split()[:5]
            sending, received = queues.split(":")
            yield _port(local), _port(remote), int(sending, 16), int(received, 16)


def _port(address: str) -> int:
    return int(address.rsplit(":", 1)[1], 16)
