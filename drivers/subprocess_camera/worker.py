"""The worker process of a camera: it opens the camera and passes its frames on."""

import logging
import threading
import time
from contextlib import suppress
from queue import SimpleQueue

from drivers.camera import EndOfStream, FrameTimeout, RgbdCamera
from drivers.core import CameraError
from drivers.core.process.service_connection import ServiceConnection
from drivers.core.rate_limits import ExponentialBackoff
from drivers.reconnect import ConnectionPhase, ReconnectingCamera
from drivers.subprocess_camera.frame_ring import FrameRingWriter
from drivers.subprocess_camera.messages import (
    CameraFinished,
    CameraHeartbeat,
    CameraProperties,
    CameraWorkerConfig,
    DeviceRequest,
)

_log = logging.getLogger(__name__)
POLL_S = 0.25


def run_camera(service: ServiceConnection) -> None:
    """Run the camera until the service ends the process or is gone.

    Raises:
        UserFacingError: Waiting does not help.
    """
    config: CameraWorkerConfig = service.config
    requests: SimpleQueue[DeviceRequest] = SimpleQueue()
    threading.Thread(target=_receive_requests, args=(service, requests), daemon=True).start()
    camera = config.factory()
    for request in config.requests:
        with suppress(CameraError):  # not open yet: the camera stores the setting
            request.apply(camera)
    threading.Thread(target=_apply_requests, args=(requests, camera), daemon=True).start()
    CaptureLoop(camera, service).run()


def _receive_requests(service: ServiceConnection, requests: "SimpleQueue[DeviceRequest]") -> None:
    """Body of the thread that receives requests, until the worker shall end."""
    for request in service.messages():
        requests.put(request)


def _apply_requests(requests: "SimpleQueue[DeviceRequest]", camera: RgbdCamera) -> None:
    """Body of the thread that applies requests, so that neither frames nor the service wait."""
    while True:
        try:
            requests.get().apply(camera)
        except CameraError as error:
            _log.warning("%s", error)


class CaptureLoop:
    """Reads a camera until it is stopped, a recording ends, or a permanent error occurs."""

    def __init__(self, camera: RgbdCamera, service: ServiceConnection) -> None:
        config: CameraWorkerConfig = service.config
        self._service, self._is_live, self._timeouts = service, config.is_live, config.timeouts
        self._camera = ReconnectingCamera(
            camera,
            config.status,
            first_frame_s=config.timeouts.first_frame_s if config.is_live else float("inf"),
            backoff=ExponentialBackoff(
                config.timeouts.initial_retry_s, config.timeouts.max_retry_s
            ),
            on_phase=self._report_phase,
        )
        self._ring = FrameRingWriter(config.ring_fds, config.playback_mode)
        camera.make_images = self._ring.make_images
        self._last_heartbeat_s = 0.0

    def run(self) -> None:
        """Run the loop. Raises the camera's exceptions after which it is not opened again."""
        try:
            self._camera.open()
            while not self._service.stop.is_set():
                if self._camera.loss is not None and not self._is_live:
                    raise self._camera.loss  # a recording is not opened again
                if time.monotonic() - self._last_heartbeat_s >= POLL_S:
                    self._send_heartbeat()
                if self._ring.acquire(POLL_S):
                    with suppress(FrameTimeout):
                        self._ring.put(self._camera.read(POLL_S))
        except EndOfStream:
            self._service.send(CameraFinished())
        finally:
            self._camera.close()

    def _report_phase(self, phase: ConnectionPhase) -> None:
        self._send_heartbeat()
        if phase in (ConnectionPhase.STARTING, ConnectionPhase.STREAMING):
            self._send_properties()

    def _send_heartbeat(self) -> None:
        self._last_heartbeat_s = time.monotonic()
        camera = self._camera
        timeout_s = self._timeouts.phase_timeout_s(camera.phase)
        self._service.send(CameraHeartbeat(camera.phase, camera.status, camera.counters, timeout_s))

    def _send_properties(self) -> None:
        camera = self._camera
        properties = CameraProperties(
            intrinsics_source=camera.intrinsics_source,
            frame_count=camera.frame_count,
            has_motor=camera.has_motor,
            ground_truth=camera.ground_truth,
        )
        self._service.send(properties)
