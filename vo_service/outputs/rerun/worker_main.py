"""The viewer's process: ``python -m vo_service.outputs.rerun.worker_main FD``, started by `Supervisor`.

It ends with the service, whatever happens: in order where that is possible, by force where not.
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
# One message that takes longer than this to draw is stuck in Rerun: the viewer takes no data.
MAX_DRAW_S = 2.0
# For writing out everything, once the service is gone.
FINISH_TIMEOUT_S = 5.0
# Native code that holds Python's lock stops the heartbeat; after this long the kernel steps in.
ORPHAN_TIMEOUT_S = 20.0
# Poses come first where processors are scarce.
NICENESS = 5


def main(connection: "Connection[Any, Any]") -> None:
    """Draw until the service says that nothing follows, or is gone."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_HeartbeatThread`
    job: RerunWorkerConfig = connection.recv()
    outbox = ParentConnection(connection)
    forward_logs(outbox, job.log_level)
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # tells how many threads it has
    cv2.setNumThreads(1)
    pulse = _HeartbeatThread(job, outbox)
    try:
        _log_messages(_open_recording(job), connection, pulse, outbox)
    except UserFacingError as error:
        outbox.send(RerunWorkerFailed(error))


def _open_recording(config: RerunWorkerConfig) -> "RotatingRecording":
    # Rerun is slow to import: the heart beats already.
    prepare_rerun()
    os.environ["RERUN_FLUSH_TICK_SECS"] = str(config.sink.flush_interval_s)
    drawing = import_module("vo_service.outputs.rerun.rotating_recording")
    opened: RotatingRecording = drawing.RotatingRecording(config)
    return opened


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
    """Until the service says that nothing follows, or is gone."""
    with suppress(EOFError, OSError):
        while not isinstance(message := receive_message(connection), RerunShutdown):
            yield message


class _HeartbeatThread:
    """A thread that tells the service how it goes, and ends the process where that must be."""

    def __init__(self, config: RerunWorkerConfig, parent: ParentConnection) -> None:
        self._config, self._parent = config, parent
        self._busy_since_s = float("inf")
        self.health = RerunHealth()
        threading.Thread(target=self._run, name="pulse", daemon=True).start()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """While something is drawn."""
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
        return replace(self.health, fault=f"{self._config.sink.address} does not take its data")

    def _memory_error(self) -> str:
        return (
            f"the viewer's process passed {self._config.memory_mb} MB (rerun.memory_mb), "
            "as its data is not taken fast enough; starting it again"
        )


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
    os._exit(0)  # Rerun's threads may never end
