"""The viewer's process: ``python -m vo_service.outputs.rerun.worker_main FD``.

`RerunSupervisor` starts it. It always ends with the service, by force if necessary.
"""

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from drivers.core.errors import UserFacingError
from drivers.core.process.parent_connection import (
    ParentConnection,
    forward_logs,
    ignore_terminal_signals,
)
from vo_service.config_tables import MEGABYTE
from vo_service.outputs.rerun.messages import (
    RerunHealth,
    RerunMessage,
    RerunReady,
    RerunShutdown,
    RerunWorkerConfig,
    RerunWorkerFailed,
)
from vo_service.outputs.rerun.serialization import receive_message
from vo_service.outputs.rerun.targets import prepare_rerun

if TYPE_CHECKING:
    from vo_service.outputs.rerun.rotating_recording import RotatingRecording

HEARTBEAT_S = 0.5
# If drawing one message takes longer than this, Rerun is blocked: the viewer does not read.
MAX_DRAW_S = 2.0
# Time to flush everything after the service is gone.
FINISH_TIMEOUT_S = 5.0
# Native code that holds the GIL stops the heartbeat; SIGALRM then kills the process.
ORPHAN_TIMEOUT_S = 20.0
# Poses have priority if CPUs are scarce.
NICENESS = 5


def main(connection: "Connection[Any, Any]") -> None:
    """Draw until the service sends `RerunShutdown` or ends."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_HeartbeatThread`
    config: RerunWorkerConfig = connection.recv()
    parent = ParentConnection(connection)
    forward_logs(parent, config.log_level)
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # at INFO it logs its thread count
    cv2.setNumThreads(1)
    heartbeat = _HeartbeatThread(config, parent)
    try:
        _log_messages(_open_recording(config), connection, heartbeat, parent)
    except UserFacingError as error:
        parent.send(RerunWorkerFailed(error))


def _open_recording(config: RerunWorkerConfig) -> "RotatingRecording":
    # Rerun is imported here, as that is slow and the heartbeat must run first.
    prepare_rerun()
    os.environ["RERUN_FLUSH_TICK_SECS"] = str(config.sink.flush_interval_s)
    module = import_module("vo_service.outputs.rerun.rotating_recording")
    recording: RotatingRecording = module.RotatingRecording(config)
    return recording


def _log_messages(
    recording: "RotatingRecording",
    connection: "Connection[Any, Any]",
    heartbeat: "_HeartbeatThread",
    parent: ParentConnection,
) -> None:
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICENESS)
    parent.send(RerunReady())
    for message in _receive_messages(connection):
        with heartbeat.busy():
            recording.log(message)
        heartbeat.health = RerunHealth(recording.fault, recording.data_loss)
    with heartbeat.busy():
        recording.finish()
    parent.send(RerunHealth(recording.fault, recording.data_loss))


def _receive_messages(connection: "Connection[Any, Any]") -> Iterator[RerunMessage]:
    """Yield messages until the service sends `RerunShutdown` or ends."""
    with suppress(EOFError, OSError):
        while not isinstance(message := receive_message(connection), RerunShutdown):
            yield message


class _HeartbeatThread:
    """Thread that sends the health to the service and kills the process if necessary."""

    def __init__(self, config: RerunWorkerConfig, parent: ParentConnection) -> None:
        self._config, self._parent = config, parent
        self._busy_since_s = float("inf")
        self.health = RerunHealth()
        threading.Thread(target=self._run, name="pulse", daemon=True).start()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """Mark the time during which a message is drawn."""
        self._busy_since_s = time.monotonic()
        yield
        self._busy_since_s = float("inf")

    def _run(self) -> None:
        while self._parent.is_connected:
            signal.setitimer(signal.ITIMER_REAL, ORPHAN_TIMEOUT_S)
            if _resident_mb() > self._config.memory_mb:
                self._parent.send(RerunWorkerFailed(UserFacingError(self._memory_error())))
                os._exit(1)
            self._parent.send(self._current_health())
            time.sleep(HEARTBEAT_S)
        time.sleep(FINISH_TIMEOUT_S)
        os._exit(1)

    def _current_health(self) -> RerunHealth:
        if time.monotonic() - self._busy_since_s < MAX_DRAW_S:
            return self.health
        return replace(self.health, fault=f"{self._config.sink.address} does not read its data")

    def _memory_error(self) -> str:
        return (
            f"the viewer's process exceeded {self._config.memory_mb} MB (rerun.memory_mb), "
            "as its data is not read fast enough; starting it again"
        )


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
    os._exit(0)  # Rerun's threads may never end
