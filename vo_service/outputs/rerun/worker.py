"""The viewer's process: it draws what the service sends. Rerun is loaded only here."""

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING

from drivers.core.process.service_connection import ServiceConnection
from vo_service.outputs.rerun.messages import RerunHealth, RerunWorkerConfig
from vo_service.outputs.rerun.targets import prepare_rerun

if TYPE_CHECKING:
    from vo_service.outputs.rerun.rotating_recording import RotatingRecording

HEARTBEAT_S = 0.5
# The sink is checked this often while nothing is drawn.
CHECK_PERIOD_S = 1.0
# If drawing one message takes longer than this, Rerun is blocked: the viewer does not read.
MAX_DRAW_S = 2.0


def run_viewer(service: ServiceConnection) -> None:
    """Draw until the service asks the process to end, or ends itself.

    Raises:
        UserFacingError: The sink cannot be opened, or the viewer has gone.
    """
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # at INFO it logs its thread count
    recording = _open_recording(service.config)
    heartbeat = _HeartbeatThread(service, recording)
    for message in service.messages(idle_s=CHECK_PERIOD_S):
        with heartbeat.busy():
            recording.check() if message is None else recording.log(message)
    with heartbeat.busy():
        recording.finish()
    service.send(RerunHealth(recording.fault, recording.data_loss))


def _open_recording(config: RerunWorkerConfig) -> "RotatingRecording":
    # Rerun is imported here, as it reads its settings when it is loaded.
    prepare_rerun()
    os.environ["RERUN_FLUSH_TICK_SECS"] = str(config.sink.flush_interval_s)
    module = import_module("vo_service.outputs.rerun.rotating_recording")
    recording: RotatingRecording = module.RotatingRecording(config)
    return recording


class _HeartbeatThread:
    """Thread that sends the health to the service, also while Rerun is blocked.

    It keeps the recording until the process ends: a stream that is freed waits until its data is
    written, forever if the disk is full.
    """

    def __init__(self, service: ServiceConnection, recording: "RotatingRecording") -> None:
        self._service, self._recording = service, recording
        self._busy_since_s = float("inf")
        threading.Thread(target=self._run, name="heartbeat", daemon=True).start()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """Mark the time during which a message is drawn."""
        self._busy_since_s = time.monotonic()
        yield
        self._busy_since_s = float("inf")

    def _run(self) -> None:
        while self._service.send(self._current_health()):
            time.sleep(HEARTBEAT_S)

    def _current_health(self) -> RerunHealth:
        health = RerunHealth(self._recording.fault, self._recording.data_loss)
        if time.monotonic() - self._busy_since_s < MAX_DRAW_S:
            return health
        address = self._service.config.sink.address
        return replace(health, fault=f"{address} does not read its data")
