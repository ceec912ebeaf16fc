"""Targets as users write them: serve, connect, connect:HOST:PORT or FILE.rrd."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from drivers.errors import InputError
from vo_service.settings import RerunSettings
from vo_service.viewer.browser import WEB_PORT, Browser, free_port
from vo_service.viewer.recording_file import RecordingFile
from vo_service.viewer.sinks import DATA_PORT, Sink, Viewer

# What the viewer's process takes before anything is kept: Python, OpenCV, Rerun. Measured, as is
# that Rerun takes more than it is allowed.
_PROCESS_MB = 220
_MB_PER_MB_KEPT = 2
_LEAST_HISTORY_MB = 20


def sink_of(target: str, settings: RerunSettings = RerunSettings()) -> Sink:  # noqa: B008 (frozen)
    """The place that a target names. Raises InputError if it names none."""
    if target == "serve":
        history_mb = max(_LEAST_HISTORY_MB, (settings.memory_mb - _PROCESS_MB) // _MB_PER_MB_KEPT)
        return Browser(free_port(DATA_PORT), free_port(WEB_PORT), history_mb)
    if target.endswith(".rrd"):
        return RecordingFile(Path(target), settings.file_mb, settings.files_kept)
    return _viewer(target)


def _viewer(target: str) -> Viewer:
    if target == "connect":
        return Viewer()
    if target.startswith("connect:"):
        return Viewer(f"rerun+http://{target.removeprefix('connect:')}/proxy")
    raise InputError(f"rerun target {target!r}: use serve, connect, connect:HOST:PORT or FILE.rrd")


def check_places(targets: Sequence[str]) -> None:
    """Raises InputError if one is none, or two are one place and would destroy each other's data.

    Opens nothing.
    """
    taken: dict[str, str] = {}
    for target in targets:
        place = _place(target)
        if place in taken:
            raise InputError(
                f"rerun targets {taken[place]!r} and {target!r} are the same place; leave one out"
            )
        taken[place] = target


def _place(target: str) -> str:
    """The same for two targets only where they are one place."""
    if target == "serve":
        return target
    return os.path.realpath(target) if target.endswith(".rrd") else _viewer(target).address


def prepare_rerun() -> None:
    """Before it is imported. Raises InputError if it is not installed."""
    if find_spec("rerun") is None:
        raise InputError("Rerun is not installed: pip install 'kinect-vo[rerun]'")
    # Rerun reads this when it is loaded, and would tell about its ports and threads otherwise.
    os.environ.setdefault("RUST_LOG", "error")
