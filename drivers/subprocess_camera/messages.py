"""The messages between the service and the worker process of a camera."""

from dataclasses import dataclass

from drivers.camera import (
    CameraCounters,
    CameraFactory,
    CameraStatus,
    Led,
    PlaybackMode,
    RgbdCamera,
)
from drivers.core.geometry import Trajectory
from drivers.core.process.messages import Heartbeat, WorkerFailed
from drivers.reconnect import INITIAL_RETRY_S, MAX_RETRY_S, ConnectionPhase
from drivers.subprocess_camera.frame_ring import FrameRingFds


@dataclass(frozen=True)
class DeviceRequest:
    """A call of `RgbdCamera.set_tilt_deg` or `set_led`."""

    setter: str
    value: float | Led

    def apply(self, camera: RgbdCamera) -> None:
        """Apply the request. Raises CameraError if that is not possible now."""
        getattr(camera, self.setter)(self.value)


@dataclass(frozen=True)
class Timeouts:
    """Time limits in seconds. A worker that sends nothing for longer counts as hung and is killed.

    Attributes:
        launching_s: Until the first message: Python and OpenCV may load from a slow disk.
        opening_s: For the camera's `open`; with killing the process it stays below 5 s.
        closing_s: For the camera's `close`.
        heartbeat_s: Between two messages while the worker waits for frames or delivers them.
        first_frame_s: From `open` to the first frame of a live camera. It is longer than the
            cameras' own 2 s, because their errors say more.
        initial_retry_s: Delay before the first retry; it doubles with each failure.
        max_retry_s: The longest delay before a retry.
        orphan_s: Until a worker whose service has ended exits, even if it hangs in native code
            that holds the GIL.
    """

    launching_s: float = 20.0
    opening_s: float = 4.5
    closing_s: float = 2.0
    heartbeat_s: float = 1.5
    first_frame_s: float = 2.5
    initial_retry_s: float = INITIAL_RETRY_S
    max_retry_s: float = MAX_RETRY_S
    orphan_s: float = 10.0

    def phase_timeout_s(self, phase: ConnectionPhase) -> float:
        """Return the longest time without a message in this phase."""
        match phase:
            case ConnectionPhase.OPENING:
                return self.opening_s
            case ConnectionPhase.CLOSING:
                return self.closing_s
            case _:
                return self.heartbeat_s


@dataclass(frozen=True)
class CameraWorkerConfig:
    """What the worker is to do.

    Attributes:
        playback_mode: Whether the worker waits for a late reader.
        is_live: Whether a lost camera is opened again; the loss of a recording is an error.
        ring_fds: File descriptors of the ring of frames.
        status: The status of the camera so far.
        requests: The requests to the camera so far.
    """

    factory: CameraFactory
    playback_mode: PlaybackMode
    is_live: bool
    timeouts: Timeouts
    ring_fds: FrameRingFds
    status: CameraStatus
    requests: tuple[DeviceRequest, ...]

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors of the ring."""
        return self.ring_fds.all


@dataclass(frozen=True)
class CameraHeartbeat(Heartbeat):
    """From the worker, at every change and several times a second: it is alive."""

    phase: ConnectionPhase
    status: CameraStatus
    counters: CameraCounters
    phase_timeout_s: float

    @property
    def activity(self) -> str:
        """What happens with the camera."""
        return str(self.phase)

    @property
    def timeout_s(self) -> float:
        """The time limit of the phase."""
        return self.phase_timeout_s


@dataclass(frozen=True)
class CameraProperties:
    """From the worker, after `open` and with the first frame: the properties of the camera.

    The defaults hold before that; then it is unknown whether there is a motor.
    """

    intrinsics_source: str = ""
    frame_count: int | None = None
    has_motor: bool = True
    ground_truth: Trajectory | None = None


@dataclass(frozen=True)
class CameraFinished:
    """From the worker, as the last message: the last frame of the recording was delivered."""


CameraWorkerMessage = CameraHeartbeat | CameraProperties | CameraFinished | WorkerFailed
