"""Free ports of this computer's own address."""

import socket
from contextlib import suppress

LOOPBACK = "127.0.0.1"


def probe_port(port: int = 0) -> int:
    """Return the port if a program may listen on it now, and any such port for 0.

    Raises:
        OSError, OverflowError: Another program has the port, or it is not one.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((LOOPBACK, port))
        return int(probe.getsockname()[1])


def free_port(preferred: int) -> int:
    """Return the preferred port or, if it is in use (by a viewer, say), any free one."""
    for port in (preferred, 0):
        with suppress(OSError):
            return probe_port(port)
    return preferred
