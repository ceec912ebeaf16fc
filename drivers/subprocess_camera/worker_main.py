"""The driver's process: ``python -m drivers.subprocess_camera.worker_main FD``, started by `WorkerProcess`.

It ends with the service, whatever happens: in order where that is possible, by force where not.
"""

import logging
import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

import cv2

from drivers.camera import RgbdCamera
from drivers.core.errors import CameraError, UserFacingError
from drivers.core.process.parent_connection import (
    ParentConnection,
    forward_logs,
    ignore_terminal_signals,
)
from drivers.subprocess_camera.capture_loop import CaptureLoop
from drivers.subprocess_camera.device_requests import DeviceRequest
from drivers.subprocess_camera.frame_ring import FrameRingWriter
from drivers.subprocess_camera.messages import CameraFinished, StartCameraWorker
from drivers.subprocess_camera.timeouts import Timeouts

_log = logging.getLogger(__name__)


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says that this is the end, or is gone."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_hear`
    job: StartCameraWorker = connection.recv()
    outbox = ParentConnection(connection)
    forward_logs(outbox, job.log_level)
    cv2.setNumThreads(1)
    stop = threading.Event()
    wishes: SimpleQueue[DeviceRequest] = SimpleQueue()
    listening = (connection, wishes, stop, job.config.timeouts)
    threading.Thread(target=_receive_requests, args=listening, daemon=True).start()
    try:
        camera = job.config.factory()
        for wish in job.requests:
            with suppress(CameraError):  # it is not open yet: it remembers
                wish.apply(camera)
        threading.Thread(target=_apply_requests, args=(wishes, camera), daemon=True).start()
        CaptureLoop(
            camera, FrameRingWriter(job.ring_fds, job.config.playback_mode), job, outbox.send, stop
        ).run()
    except UserFacingError as error:
        outbox.send(CameraFinished(error))


def _receive_requests(
    connection: "Connection[Any, Any]",
    requests: "SimpleQueue[DeviceRequest]",
    stop: threading.Event,
    timeouts: Timeouts,
) -> None:
    """Body of the thread that hears the service's wishes, and ends the process with it."""
    with suppress(EOFError, OSError):
        while (wish := _receive_request(connection, timeouts)) is not None:
            requests.put(wish)
    stop.set()
    threading.main_thread().join(timeouts.closing_s)
    os._exit(1)


def _apply_requests(requests: "SimpleQueue[DeviceRequest]", camera: RgbdCamera) -> None:
    """Body of the thread that does as it is told: neither frames nor the service wait for it."""
    while True:
        try:
            requests.get().apply(camera)
        except CameraError as error:
            _log.warning("%s", error)


def _receive_request(
    connection: "Connection[Any, Any]", timeouts: Timeouts
) -> DeviceRequest | None:
    """The next wish; None at the end. Raises EOFError or OSError if the service is gone."""
    while True:
        # The kernel's alarm clock ends the process if nobody sets it again: native code that hangs
        # while it holds Python's lock stops this thread too.
        signal.setitimer(signal.ITIMER_REAL, timeouts.orphan_s)
        if connection.poll(timeouts.orphan_s / 3):
            wish: DeviceRequest | None = connection.recv()
            return wish


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
