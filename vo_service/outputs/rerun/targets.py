"""Targets of Rerun as users write them: serve, connect, connect:HOST:PORT or FILE.rrd."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from drivers.core import InputError
from vo_service.config_tables import RerunConfig
from vo_service.outputs.loopback_ports import LOOPBACK, free_port, probe_port
from vo_service.outputs.rerun.sinks import (
    DATA_PORT,
    LiveSink,
    PortTakenError,
    RrdFileSink,
    RunningViewerSink,
    Sink,
)

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


def _check_port_free(port: int) -> None:
    """Raise PortTakenError if the port is in use: Rerun would only log it and show nothing."""
    try:
        probe_port(port)
    except (OSError, OverflowError) as error:
        raise PortTakenError(port, error) from error


# Measured: Python, OpenCV, Rerun and their libraries without history; Rerun then takes twice its
# limit.
_BASE_PROCESS_MB = 220
_PROCESS_MB_PER_HISTORY_MB = 2
_MIN_HISTORY_MB = 20


def make_sink(target: str, settings: RerunConfig = RerunConfig()) -> Sink:  # noqa: B008 (frozen)
    """Make the sink of a target.

    Raises:
        InputError: If the target is invalid.
    """
    if target == "serve":
        history_mb = max(
            _MIN_HISTORY_MB, (settings.memory_mb - _BASE_PROCESS_MB) // _PROCESS_MB_PER_HISTORY_MB
        )
        return BrowserSink(free_port(DATA_PORT), free_port(WEB_PORT), history_mb)
    if target.endswith(".rrd"):
        return RrdFileSink(Path(target), settings.file_mb, settings.files_kept)
    return _running_viewer_sink(target)


def _running_viewer_sink(target: str) -> RunningViewerSink:
    if target == "connect":
        return RunningViewerSink()
    if target.startswith("connect:"):
        return RunningViewerSink(f"rerun+http://{target.removeprefix('connect:')}/proxy")
    raise InputError(f"rerun target {target!r}: use serve, connect, connect:HOST:PORT or FILE.rrd")


def check_targets(targets: Sequence[str]) -> None:
    """Check targets without opening them.

    Raises:
        InputError: A target is invalid, or two are the same and would overwrite each other.
    """
    seen: dict[str, str] = {}
    for target in targets:
        canonical = _canonical_target(target)
        if canonical in seen:
            raise InputError(
                f"rerun targets {seen[canonical]!r} and {target!r} are the same; remove one"
            )
        seen[canonical] = target


def _canonical_target(target: str) -> str:
    """Return a text that is equal only for two names of the same target."""
    if target == "serve":
        return target
    return (
        os.path.realpath(target)
        if target.endswith(".rrd")
        else _running_viewer_sink(target).address
    )


def prepare_rerun() -> None:
    """Prepare the import of rerun.

    Raises:
        InputError: If it is not installed.
    """
    if find_spec("rerun") is None:
        raise InputError("Rerun is not installed: pip install 'kinect-vo[rerun]'")
    # Rerun reads this when it is loaded; without it, it logs its ports and threads.
    os.environ.setdefault("RUST_LOG", "error")
