"""Messages between the service and a camera's worker process, besides frames."""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import CameraCounters, CameraStatus, PlaybackMode, RgbdCamera
from drivers.core.errors import UserFacingError
from drivers.core.process.messages import LogMessage
from drivers.core.trajectory import Trajectory
from drivers.subprocess_camera.device_requests import DeviceRequest
from drivers.subprocess_camera.frame_ring import FrameRingFds
from drivers.subprocess_camera.timeouts import Timeouts, WorkerPhase

# Makes the camera in the worker process: a class or function of a module, or a partial of one.
CameraFactory = Callable[[], RgbdCamera]


@dataclass(frozen=True)
class CameraWorkerConfig:
    """The configuration of a camera's worker process.

    Attributes:
        is_live: Whether a lost camera is opened again; the loss of a recording is an error.
    """

    factory: CameraFactory
    playback_mode: PlaybackMode
    is_live: bool
    timeouts: Timeouts


@dataclass(frozen=True)
class StartCameraWorker:
    """To the worker, as the first message; requests follow, and None at the end.

    Attributes:
        status: The status of the camera so far.
        requests: The requests to the camera so far.
        log_level: Level of the service's log.
    """

    config: CameraWorkerConfig
    ring_fds: FrameRingFds
    status: CameraStatus
    requests: tuple[DeviceRequest, ...]
    log_level: int


@dataclass(frozen=True)
class CameraHeartbeat:
    """From the worker, at every change and several times a second: it is alive.

    The counters are totals over all times that this worker opened its camera.
    """

    phase: WorkerPhase
    status: CameraStatus
    counters: CameraCounters


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
    """From the worker, as the last message: no frame will follow; the error is None at the end."""

    error: UserFacingError | None = None


CameraWorkerMessage = CameraHeartbeat | CameraProperties | CameraFinished | LogMessage
