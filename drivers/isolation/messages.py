"""What the service's process and the driver's process say to each other, beside frames."""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import CameraCounters, Condition, Pace, RgbdCamera
from drivers.errors import UserFacingError
from drivers.isolation.limits import Phase, TimeLimits
from drivers.isolation.ring import RingEnds
from drivers.isolation.wishes import Wish
from drivers.trajectory import StampedPoses

# Makes the camera, in the driver's process: a class or function of a module, or a partial of one.
Recipe = Callable[[], RgbdCamera]


@dataclass(frozen=True)
class Task:
    """What a driver's process is for.

    is_live  a camera that goes is opened again; a recording that goes is an error
    """

    recipe: Recipe
    pace: Pace
    is_live: bool
    limits: TimeLimits


@dataclass(frozen=True)
class Job:
    """To the driver, first and once; after it come wishes, and None at the end.

    condition  what is known of the camera so far
    wishes     what was asked of the camera so far
    log_level  of the service's log
    """

    task: Task
    ring: RingEnds
    condition: Condition
    wishes: tuple[Wish, ...]
    log_level: int


@dataclass(frozen=True)
class Report:
    """From the driver, at every change and several times a second: its sign of life.

    The counters are totals over all times that this driver opened its camera.
    """

    phase: Phase
    condition: Condition
    counters: CameraCounters


@dataclass(frozen=True)
class Facts:
    """From the driver, after `open` and with the first frame: what the camera says of itself.

    Whether it has a base nobody knows before that.
    """

    intrinsics_source: str = ""
    frame_count: int | None = None
    has_base: bool = True
    ground_truth: StampedPoses | None = None


@dataclass(frozen=True)
class Ended:
    """From the driver, last: no frame will follow, because of an error or without one."""

    error: UserFacingError | None = None


@dataclass(frozen=True)
class LogLine:
    """From the driver, for the service's log."""

    level: int
    logger: str
    text: str


Word = Report | Facts | Ended | LogLine
