"""Rerun's pictures in a browser of this computer."""

import socket
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import quote

from vo_service.outputs.rerun_page import PageServer, port_taken
from vo_service.outputs.rerun_sinks import DATA_PORT, LOOPBACK, LiveSink

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

WEB_PORT = 9090
# What a browser that comes late can still see.
SERVER_MEMORY = "100MB"


class Browser(LiveSink):
    """Data and page are served on loopback, to whoever is on this computer: there is no password.

    From elsewhere, tunnel both ports: ``ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 ROBOT``.
    """

    def __init__(self, data_port: int = DATA_PORT, web_port: int = WEB_PORT) -> None:
        self._data_port = data_port
        data = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        self.address = f"http://{LOOPBACK}:{web_port}/?url={quote(data, safe='')}"
        _check_free(data_port)
        self._page = PageServer(web_port, data_port)

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Serve the stream's data from this process."""
        import rerun as rr

        data = rr.GrpcServerSink(LOOPBACK, self._data_port, server_memory_limit=SERVER_MEMORY)
        stream.set_sinks(data, default_blueprint=blueprint)

    def close(self) -> None:
        """Serve the page no more."""
        self._page.close()


def free_port(preferred: int) -> int:
    """The preferred port of loopback, or any other where that one is taken (by a viewer, say)."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with suppress(OSError):
                probe.bind((LOOPBACK, port))
                return int(probe.getsockname()[1])
    return preferred


def _check_free(port: int) -> None:
    """Rerun only logs a taken port and then shows nothing, so look first."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise port_taken(port, error) from error
