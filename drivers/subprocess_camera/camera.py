"""Any camera in a process of its own, which is restarted if a native library hangs or crashes."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraFactory,
    CameraStatus,
    Clock,
    Led,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core.errors import CameraError, CameraLostError
from drivers.core.trajectory import Trajectory
from drivers.subprocess_camera.client import CameraWorkerClient
from drivers.subprocess_camera.frame_ring import FrameRingEndedError, FrameRingReader
from drivers.subprocess_camera.messages import DeviceRequest, SetLed, SetTilt, Timeouts

Sequencer = Callable[[RgbdFrame], RgbdFrame | None]


class SubprocessCamera(RgbdCamera):
    """A camera in a process of its own; frames pass through shared memory.

    A live camera (`clock` is monotonic) is opened again after each loss: `open` returns at once,
    `read` times out while the camera is lost, and `status` gives the reason. `seq` and stamps rise
    across all of these, and across `close` and `open`.

    A recording is opened by `open` and starts with the first `read`. It is never restarted: if its
    process dies, `read` raises CameraLostError.

    In lockstep the camera waits for a late reader; in realtime the reader gets the newest frame.

    A permanent error (InputError, a library that is not installed) is raised by `open` of a
    recording, and by `read` of a live camera.

    Args:
        name: Name for messages.
        clock: Clock of the stamps; monotonic for a live camera.
        factory: Makes the camera in the worker process; a module's class or function, or a partial.
        playback_mode: Lockstep or realtime.
        timeouts: Time limits of the worker process.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        factory: CameraFactory,
        playback_mode: PlaybackMode,
        timeouts: Timeouts = Timeouts(),  # noqa: B008 (frozen)
    ) -> None:
        self.name, self.clock = name, clock
        self.reconnects = clock is Clock.MONOTONIC
        self._ring = FrameRingReader(playback_mode)
        self._client = CameraWorkerClient(
            factory, playback_mode, self.reconnects, timeouts, self._ring
        )
        self._sequencer = make_sequencer(clock, playback_mode)
        self._delivered = self._skipped = 0

    def open(self) -> None:
        """Start the worker process; see the class."""
        self.close()
        try:
            self._ring.open()
            self._client.start()
            if not self.reconnects:
                self._client.wait_until_open()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame, see `RgbdCamera.read`. Raises also permanent errors."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = self._sequencer(self._get_frame(max(0.0, deadline_s - time.monotonic())))
            if frame is not None:
                self._delivered += 1
                return frame
            self._skipped += 1

    def close(self) -> None:
        """End the process. Properties and counters remain valid."""
        try:
            self._client.stop()
        finally:
            self._ring.close()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; up to 0.3 s old."""
        own = CameraCounters(dropped=self._ring.dropped, skipped=self._skipped)
        return replace(self._client.counters + own, delivered=self._delivered)

    @property
    def status(self) -> CameraStatus:
        """The status of the camera, or of its process."""
        return self._client.status

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" until the camera has been open."""
        return self._client.camera_properties.intrinsics_source

    @property
    def frame_count(self) -> int | None:
        """The camera's number of frames; None until it has been open."""
        return self._client.camera_properties.frame_count

    @property
    def has_motor(self) -> bool:
        """Whether the camera has a motor and an LED; True until it has been open."""
        return self._client.camera_properties.has_motor

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Request a tilt, see `RgbdCamera.set_tilt_deg`. A missing motor is logged later."""
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._request(SetTilt(tilt_deg))

    def set_led(self, led: Led) -> None:
        """Request a state of the LED, as `set_tilt_deg` does."""
        if not self.has_motor:
            super().set_led(led)
        self._request(SetLed(led))

    @property
    def ground_truth(self) -> Trajectory | None:
        """True poses from the camera; None until it has been open."""
        return self._client.camera_properties.ground_truth

    def _request(self, request: DeviceRequest) -> None:
        """Send a request. Raises CameraError if the camera is not open now."""
        if not self._client.send_request(request):
            raise CameraError(
                f"{self.name}: not open now ({self.status}); the setting is applied when it opens"
            )

    def _get_frame(self, timeout_s: float) -> RgbdFrame:
        try:
            return self._ring.get(timeout_s)
        except FrameRingEndedError:
            raise self._client.final_exception or CameraLostError(
                f"{self.name}: not open; use `with`, or call open()"
            ) from None


def make_sequencer(clock: Clock, playback_mode: PlaybackMode) -> Sequencer:
    """Make the function that returns a frame as delivered, or None for a frame to discard."""
    if clock is Clock.MONOTONIC:
        return MonotonicSequence()
    return stamp_receive_time if playback_mode is PlaybackMode.LOCKSTEP else pass_through


class MonotonicSequence:
    """Keeps `seq` and stamps of a live camera rising, however often it is opened again.

    A camera that is opened again counts from 0; its numbers continue here from the last one. Its
    new clock estimate may put its first frames before the last ones: those are discarded.
    """

    def __init__(self) -> None:
        self._last_stamp_s = -float("inf")
        self._last_seq = -1
        self._seq_offset = 0

    def __call__(self, frame: RgbdFrame) -> RgbdFrame | None:
        """Return the frame with its new number; None if its stamp does not rise."""
        if frame.stamp_s <= self._last_stamp_s:
            return None
        if frame.seq + self._seq_offset <= self._last_seq:
            self._seq_offset = self._last_seq + 1 - frame.seq
        self._last_stamp_s, self._last_seq = frame.stamp_s, frame.seq + self._seq_offset
        return replace(frame, seq=self._last_seq)


def stamp_receive_time(frame: RgbdFrame) -> RgbdFrame:
    """Set the receive time to now: in lockstep a frame arrives when it is read."""
    return replace(frame, receive_time_s=time.monotonic())


def pass_through(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame unchanged, for a recording in realtime."""
    return frame
