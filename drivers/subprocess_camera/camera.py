"""Any camera, in a process of its own: a native library that hangs or crashes is started again."""

import time
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraStatus,
    Clock,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core.errors import CameraError, CameraLostError
from drivers.core.trajectory import Trajectory
from drivers.sensor_config import Led
from drivers.subprocess_camera.device_requests import DeviceRequest, SetLed, SetTilt
from drivers.subprocess_camera.frame_ring import FrameRingEndedError, FrameRingReader
from drivers.subprocess_camera.messages import CameraFactory, CameraWorkerConfig
from drivers.subprocess_camera.sequencing import make_sequencer
from drivers.subprocess_camera.supervisor import CameraWorkerSupervisor
from drivers.subprocess_camera.timeouts import Timeouts


class SubprocessCamera(RgbdCamera):
    """The camera that `recipe` makes, in a process of its own; frames come through shared memory.

    A live camera (`clock` monotonic) is opened, and opened again, for as long as this one is open:
    `open` returns at once, `read` has no frame while the camera is away, and `condition` says why.
    `seq` and stamps rise over all of that, and over `close` and `open` here.

    A recording is opened by `open`, starts to run with the first `read` and is never begun anew by
    itself: if its process dies, `read` raises CameraLostError.

    In lockstep a late reader makes the camera wait; in realtime it gets the newest frame.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        factory: CameraFactory,
        playback_mode: PlaybackMode,
        timeouts: Timeouts = Timeouts(),  # noqa: B008 (frozen)
    ) -> None:
        """`recipe` is called in the other process: a class or function of a module, or a partial.

        What is wrong for good (InputError, a library that is not installed) is raised by `open`
        of a recording, and by `read` of a live camera.
        """
        self.name, self.clock = name, clock
        self._is_live = clock is Clock.MONOTONIC
        self._ring = FrameRingReader(playback_mode)
        self._supervisor = CameraWorkerSupervisor(
            CameraWorkerConfig(factory, playback_mode, self._is_live, timeouts), self._ring
        )
        self._sequencer = make_sequencer(clock, playback_mode)
        self._delivered = self._skipped = 0

    def open(self) -> None:
        """Start the process; see the class."""
        self.close()
        self._delivered = self._skipped = 0
        try:
            self._ring.open()
            self._supervisor.start()
            if not self._is_live:
                self._supervisor.wait_until_open()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`. Raises also what is wrong for good."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = self._sequencer(self._get_frame(max(0.0, deadline_s - time.monotonic())))
            if frame is not None:
                self._delivered += 1
                return frame
            self._skipped += 1

    def close(self) -> None:
        """End the process; what was found out and counted can still be asked for."""
        try:
            self._supervisor.stop()
        finally:
            self._ring.close()

    @property
    def counters(self) -> CameraCounters:
        """Totals since `open`, however often the camera was opened; up to 0.3 s behind."""
        mine = CameraCounters(dropped=self._ring.dropped, skipped=self._skipped)
        return replace(self._supervisor.counters + mine, delivered=self._delivered)

    @property
    def status(self) -> CameraStatus:
        """How the camera is, or what became of its process."""
        return self._supervisor.status

    @property
    def intrinsics_source(self) -> str:
        """What the camera says; "" until it has been open."""
        return self._supervisor.camera_properties.intrinsics_source

    @property
    def frame_count(self) -> int | None:
        """What the camera says; None until it has been open."""
        return self._supervisor.camera_properties.frame_count

    @property
    def has_motor(self) -> bool:
        """What the camera says; True until it has been open."""
        return self._supervisor.camera_properties.has_motor

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `RgbdCamera`. If the motor is not there, the log says so, a little later."""
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._request(SetTilt(tilt_deg))

    def set_led(self, led: Led) -> None:
        """See `RgbdCamera`, and `set_tilt_deg`."""
        if not self.has_motor:
            super().set_led(led)
        self._request(SetLed(led))

    @property
    def ground_truth(self) -> Trajectory | None:
        """What the camera says; None until it has been open."""
        return self._supervisor.camera_properties.ground_truth

    def _request(self, request: DeviceRequest) -> None:
        """Raises CameraError if the camera is not open to hear it now."""
        if not self._supervisor.send_request(request):
            raise CameraError(
                f"{self.name}: not open now ({self.status}); it is done as soon as it is open"
            )

    def _get_frame(self, timeout_s: float) -> RgbdFrame:
        try:
            return self._ring.get(timeout_s)
        except FrameRingEndedError:
            raise self._supervisor.final_exception or CameraLostError(
                f"{self.name}: not open; open it again"
            ) from None
