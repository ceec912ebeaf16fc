"""Targets as users write them: serve, connect, connect:HOST:PORT or FILE.rrd."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from drivers.core.errors import InputError
from vo_service.config_tables import RerunConfig
from vo_service.outputs.rerun.browser_sink import WEB_PORT, BrowserSink, free_port
from vo_service.outputs.rerun.sinks import DATA_PORT, RrdFileSink, RunningViewerSink, Sink

# Measured: memory of Python, OpenCV and Rerun without history; Rerun then takes twice its limit.
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
