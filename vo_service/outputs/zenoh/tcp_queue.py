"""Number of TCP bytes that were sent but not read yet, from Linux's socket tables."""

from collections.abc import Iterable, Iterator
from pathlib import Path

PROC_TCP_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))

PortPair = tuple[int, int]


def queued_bytes(connections: Iterable[PortPair]) -> int:
    """Count the unread bytes of connections, given as (local port, remote port).

    These are unacknowledged bytes and, if the peer runs on this host, bytes in its receive queue.
    """
    pairs = set(connections)
    total = 0
    for local, remote, send_queue, receive_queue in _sockets():
        if (local, remote) in pairs:
            total += send_queue
        elif (remote, local) in pairs:
            total += receive_queue
    return total


def _sockets() -> Iterator[tuple[int, int, int, int]]:
    """Yield local port, remote port, bytes in the send queue, bytes in the receive queue."""
    for table in PROC_TCP_TABLES:
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for line in lines:
            _, local, remote, _, queues = line.split()[:5]
            sending, received = queues.split(":")
            yield _port(local), _port(remote), int(sending, 16), int(received, 16)


def _port(address: str) -> int:
    return int(address.rsplit(":", 1)[1], 16)
