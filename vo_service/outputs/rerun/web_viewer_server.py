"""Local server of Rerun's web viewer, without access to the internet.

The viewer is three files inside Rerun's own web server. Unchanged, the page reports its use and
loads fonts and release notes from the internet. This server adds a policy that restricts the
browser to this computer. It runs in this process, so no server is left behind.
"""

import json
import os
import re
import socket
import subprocess
import tempfile
import time
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from threading import Lock, Thread
from typing import Any
from urllib.request import urlopen

from drivers.core import UserFacingError
from vo_service.outputs.loopback_ports import LOOPBACK, probe_port
from vo_service.outputs.rerun.sinks import PortTakenError

_FILES = {
    "": "text/html",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
_START_TIMEOUT_S = 10.0


class WebViewerServer:
    """Serves the page on loopback until closed.

    Raises:
        PortTakenError: If the port is in use.
    """

    def __init__(self, port: int, data_port: int) -> None:
        handler = partial(_PageRequestHandler, _ViewerFiles(), _content_security_policy(data_port))
        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), handler)
        except (OSError, OverflowError) as error:
            raise PortTakenError(port, error) from error
        Thread(target=self._server.serve_forever, name="rerun page", daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


class _ViewerFiles:
    """The viewer's files, fetched at the first request."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._files: dict[str, bytes] = {}

    def file(self, name: str) -> bytes:
        with self._lock:
            if not self._files:
                self._files = _fetch_files()
            return self._files[name]


class _PageRequestHandler(BaseHTTPRequestHandler):
    def __init__(self, viewer: _ViewerFiles, policy: str, *args: Any) -> None:
        self._viewer = viewer
        self._policy = policy
        super().__init__(*args)

    def do_GET(self) -> None:
        name = self.path.split("?")[0].removeprefix("/")
        if name not in _FILES:
            self.send_error(404)
            return
        content = self._viewer.file(name)
        self.send_response(200)
        self.send_header("Content-Type", _FILES[name])
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", self._policy)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (the base class's name)
        """Print nothing on the terminal."""


def _content_security_policy(data_port: int) -> str:
    """Return a Content-Security-Policy that allows only this page and the data."""
    return (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
        "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; "
        f"connect-src 'self' http://{LOOPBACK}:{data_port}"
    )


def _fetch_files() -> dict[str, bytes]:
    """Start Rerun's own web server for a moment and read the files from it."""
    port = probe_port()
    # With a data source given, Rerun opens no data port of its own.
    command = [str(rerun_binary()), "--serve-web", f"rerun+http://{LOOPBACK}:1/proxy"]
    command += ["--bind", LOOPBACK, "--web-viewer-port", str(port)]
    with tempfile.TemporaryDirectory(prefix="kinect-vo-") as home:
        server = subprocess.Popen(command, env=no_telemetry_environment(Path(home)))
        try:
            wait_for_port(port)
            files = {name: _fetch(f"http://{LOOPBACK}:{port}/{name}") for name in _FILES}
        finally:
            server.kill()
            server.wait()
    return files | {"": _strip_external_links(files[""])}


def _strip_external_links(page: bytes) -> bytes:
    """Remove the font links: the policy does not stop a browser from preconnecting."""
    return re.sub(rb"<link[^>]*https://[^>]*>", b"", page)


def wait_for_port(port: int) -> None:
    """Wait until a program listens on a port.

    Raises:
        UserFacingError: After ten seconds.
    """
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline_s:
        try:
            socket.create_connection((LOOPBACK, port), timeout=1.0).close()
        except OSError:
            time.sleep(0.05)
        else:
            return
    raise UserFacingError("Rerun's web server did not start")


def _fetch(url: str) -> bytes:
    with urlopen(url, timeout=_START_TIMEOUT_S) as response:
        content: bytes = response.read()
    return content


def rerun_binary() -> Path:
    """Return the native program: killing the `rerun` script would leave it running."""
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise UserFacingError("Rerun's web server is missing: pip install 'kinect-vo[rerun]'")
    return Path(package.origin).with_name("rerun")


def no_telemetry_environment(home: Path) -> dict[str, str]:
    """Make an environment for Rerun's programs without usage reports and log output.

    Args:
        home: Empty folder for Rerun's settings; it must exist while the program runs.
    """
    settings = home / "rerun" / "analytics.json"
    settings.parent.mkdir()
    content = {  # Rerun requires all five keys
        "analytics_enabled": False,
        "analytics_id": "",
        "metadata": {},
        "config_file_path": str(settings),
        "data_dir_path": str(home),
    }
    settings.write_text(json.dumps(content))
    return os.environ | {"XDG_CONFIG_HOME": str(home), "RUST_LOG": "error"}
