"""Sink that shows Rerun in a browser on this computer."""

import socket
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import quote

from vo_service.outputs.rerun.sinks import DATA_PORT, LOOPBACK, LiveSink, PortTakenError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from vo_service.outputs.rerun.web_viewer_server import WebViewerServer

WEB_PORT = 9090


class BrowserSink(LiveSink):
    """Serves data and web page on loopback, without a password.

    For remote access, tunnel both ports:
    ``ssh -L 9090:127.0.0.1:9090 -L 9876:127.0.0.1:9876 ROBOT``.

    Args:
        data_port: Port of the data.
        web_port: Port of the web page.
        history_mb: Data kept for a browser that connects late.
    """

    def __init__(
        self, data_port: int = DATA_PORT, web_port: int = WEB_PORT, history_mb: int = 40
    ) -> None:
        self._data_port, self._web_port = data_port, web_port
        self._history_mb = history_mb
        data = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        self.address = f"http://{LOOPBACK}:{web_port}/?url={quote(data, safe='')}"
        self._pages: list[WebViewerServer] = []

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Serve page and data from this process.

        Raises:
            PortTakenError: If a port is in use.
        """
        import rerun as rr

        from vo_service.outputs.rerun.web_viewer_server import WebViewerServer

        _check_port_free(self._data_port)
        self._pages.append(WebViewerServer(self._web_port, self._data_port))
        memory = f"{self._history_mb}MB"
        data = rr.GrpcServerSink(LOOPBACK, self._data_port, server_memory_limit=memory)
        stream.set_sinks(data, default_blueprint=blueprint)

    def close(self) -> None:
        """Stop serving the page."""
        while self._pages:
            self._pages.pop().close()


def free_port(preferred: int) -> int:
    """Return the preferred loopback port or, if it is in use (by a viewer, say), any free one."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with suppress(OSError):
                probe.bind((LOOPBACK, port))
                return int(probe.getsockname()[1])
    return preferred


def _check_port_free(port: int) -> None:
    """Raise PortTakenError if the port is in use: Rerun would only log it and show nothing."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise PortTakenError(port, error) from error
