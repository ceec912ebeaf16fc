"""The worker process of a camera: ``python -m drivers.subprocess_camera.worker_main FD``.

`WorkerProcess` starts it. It always ends with the service, by force if necessary.
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
from drivers.subprocess_camera.frame_ring import FrameRingWriter
from drivers.subprocess_camera.messages import (
    CameraFinished,
    DeviceRequest,
    StartCameraWorker,
    Timeouts,
)

_log = logging.getLogger(__name__)


def main(connection: "Connection[Any, Any]") -> None:
    """Run the camera until the service ends the process or is gone."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_receive_request`
    start: StartCameraWorker = connection.recv()
    parent = ParentConnection(connection)
    forward_logs(parent, start.log_level)
    cv2.setNumThreads(1)
    stop = threading.Event()
    requests: SimpleQueue[DeviceRequest] = SimpleQueue()
    receiver_args = (connection, requests, stop, start.config.timeouts)
    threading.Thread(target=_receive_requests, args=receiver_args, daemon=True).start()
    try:
        camera = start.config.factory()
        for request in start.requests:
            with suppress(CameraError):  # not open yet: the camera stores the setting
                request.apply(camera)
        threading.Thread(target=_apply_requests, args=(requests, camera), daemon=True).start()
        ring = FrameRingWriter(start.ring_fds, start.config.playback_mode)
        CaptureLoop(camera, ring, start, parent.send, stop).run()
    except UserFacingError as error:
        parent.send(CameraFinished(error))


def _receive_requests(
    connection: "Connection[Any, Any]",
    requests: "SimpleQueue[DeviceRequest]",
    stop: threading.Event,
    timeouts: Timeouts,
) -> None:
    """Body of the thread that receives requests, and ends the process with the service."""
    with suppress(EOFError, OSError):
        while (request := _receive_request(connection, timeouts)) is not None:
            requests.put(request)
    stop.set()
    threading.main_thread().join(timeouts.closing_s)
    os._exit(1)


def _apply_requests(requests: "SimpleQueue[DeviceRequest]", camera: RgbdCamera) -> None:
    """Body of the thread that applies requests, so that neither frames nor the service wait."""
    while True:
        try:
            requests.get().apply(camera)
        except CameraError as error:
            _log.warning("%s", error)


def _receive_request(
    connection: "Connection[Any, Any]", timeouts: Timeouts
) -> DeviceRequest | None:
    """Wait for a request; None at the end. Raises EOFError or OSError if the service is gone."""
    while True:
        # The kernel's timer ends the process unless it is set again: native code that hangs while
        # it holds the GIL stops this thread too.
        signal.setitimer(signal.ITIMER_REAL, timeouts.orphan_s)
        if connection.poll(timeouts.orphan_s / 3):
            request: DeviceRequest | None = connection.recv()
            return request


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
