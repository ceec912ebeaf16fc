"""Rerun's pictures in a browser of this computer.

Rerun's own usage reports are switched off: the library inside this process sends none, and the
page's server is given a configuration that says no.
"""

import json
import os
import socket
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from drivers.errors import UserFacingError
from vo_service.outputs.rerun_sinks import DATA_PORT, LOOPBACK, LiveSink

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

WEB_PORT = 9090
# What a browser that comes late can still see.
SERVER_MEMORY = "100MB"


class Browser(LiveSink):
    """Served on loopback to a browser of this computer; nothing of it is password-protected."""

    def __init__(self, data_port: int = DATA_PORT, web_port: int = WEB_PORT) -> None:
        self._data_port = data_port
        self._web_port = web_port
        self._data = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        self.address = f"http://{LOOPBACK}:{web_port}/?url={quote(self._data, safe='')}"
        self._home = tempfile.TemporaryDirectory(prefix="kinect-vo-rerun-")
        self._server: subprocess.Popen[bytes] | None = None

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Serve the data from this process and the page from Rerun's own server."""
        import rerun as rr

        for port in (self._data_port, self._web_port):
            _check_free(port)
        data = rr.GrpcServerSink(LOOPBACK, self._data_port, server_memory_limit=SERVER_MEMORY)
        stream.set_sinks(data, default_blueprint=blueprint)
        self._server = self._start_server()

    def close(self) -> None:
        """Stop the page's server."""
        if self._server is not None:
            self._server.kill()
            self._server.wait()
        self._home.cleanup()

    def _start_server(self) -> subprocess.Popen[bytes]:
        page = ["--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(self._web_port)]
        environment = os.environ | {"XDG_CONFIG_HOME": self._without_reports(), "RUST_LOG": "error"}
        return subprocess.Popen([_rerun_binary(), *page, self._data], env=environment)

    def _without_reports(self) -> str:
        """A configuration folder in which Rerun's usage reports are off."""
        home = Path(self._home.name)
        settings = home / "rerun" / "analytics.json"
        settings.parent.mkdir()
        content = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(settings),
            "data_dir_path": str(home),
        }
        settings.write_text(json.dumps(content))
        return str(home)


def _rerun_binary() -> Path:
    """The program itself: the `rerun` command is a script, and killing that leaves it running."""
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise UserFacingError("Rerun's web server is missing: pip install 'kinect-vo[rerun]'")
    return Path(package.origin).with_name("rerun")


def _check_free(port: int) -> None:
    """Rerun only logs a taken port and then shows nothing, so look first."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise UserFacingError(
                f"rerun cannot listen on {LOOPBACK}:{port}: {error}; "
                "stop what uses the port or choose another one"
            ) from error
