"""What the service's process and the driver's process say to each other, beside frames."""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import CameraCounters, CameraStatus, PlaybackMode, RgbdCamera
from drivers.core.errors import UserFacingError
from drivers.core.process.messages import LogMessage
from drivers.core.trajectory import Trajectory
from drivers.subprocess_camera.device_requests import DeviceRequest
from drivers.subprocess_camera.frame_ring import FrameRingFds
from drivers.subprocess_camera.timeouts import Timeouts, WorkerPhase

# Makes the camera, in the driver's process: a class or function of a module, or a partial of one.
CameraFactory = Callable[[], RgbdCamera]


@dataclass(frozen=True)
class CameraWorkerConfig:
    """What a driver's process is for.

    is_live  a camera that goes is opened again; a recording that goes is an error
    """

    factory: CameraFactory
    playback_mode: PlaybackMode
    is_live: bool
    timeouts: Timeouts


@dataclass(frozen=True)
class StartCameraWorker:
    """To the driver, first and once; after it come wishes, and None at the end.

    condition  what is known of the camera so far
    wishes     what was asked of the camera so far
    log_level  of the service's log
    """

    config: CameraWorkerConfig
    ring_fds: FrameRingFds
    status: CameraStatus
    requests: tuple[DeviceRequest, ...]
    log_level: int


@dataclass(frozen=True)
class CameraHeartbeat:
    """From the driver, at every change and several times a second: its sign of life.

    The counters are totals over all times that this driver opened its camera.
    """

    phase: WorkerPhase
    status: CameraStatus
    counters: CameraCounters


@dataclass(frozen=True)
class CameraProperties:
    """From the driver, after `open` and with the first frame: what the camera says of itself.

    Whether it has a base nobody knows before that.
    """

    intrinsics_source: str = ""
    frame_count: int | None = None
    has_motor: bool = True
    ground_truth: Trajectory | None = None


@dataclass(frozen=True)
class CameraFinished:
    """From the driver, last: no frame will follow, because of an error or without one."""

    error: UserFacingError | None = None


CameraWorkerMessage = CameraHeartbeat | CameraProperties | CameraFinished | LogMessage
