"""How long a driver may take for what, and how soon it is tried again."""

from dataclasses import dataclass
from enum import StrEnum


class WorkerPhase(StrEnum):
    """What the driver is busy with, as it may hang while doing it."""

    LAUNCHING = "starting up"
    OPENING = "opening the camera"
    STARTING = "waiting for the first frame"
    STREAMING = "reading frames"
    CLOSING = "closing the camera"
    WAITING = "waiting to open the camera again"


@dataclass(frozen=True)
class Timeouts:
    """Seconds. A driver that says nothing for longer is taken for hung, and killed.

    launching_s      until the new process says its first word: Python and OpenCV, from a slow disk
    opening_s        for the camera's `open`: said, and the process ended, within 5 s
    closing_s        for the camera's `close`
    heartbeat_s      between two words of a driver that waits for frames or delivers them
    first_frame_s    from `open` until a live camera counts as lost if it sends nothing; a little
                     more than the 2 s that cameras allow themselves, since they know more to say
    initial_retry_s    before a camera or driver that failed is tried again; doubled each time, up to
    max_retry_s
    orphan_s         until a driver whose service is gone ends even if it hangs in native code that
                     holds Python's lock
    """

    launching_s: float = 20.0
    opening_s: float = 4.5
    closing_s: float = 2.0
    heartbeat_s: float = 1.5
    first_frame_s: float = 2.5
    initial_retry_s: float = 0.2
    max_retry_s: float = 1.5
    orphan_s: float = 10.0

    def heartbeat_timeout_s(self, phase: WorkerPhase) -> float:
        """How long the driver may say nothing in this phase."""
        match phase:
            case WorkerPhase.LAUNCHING:
                return self.launching_s
            case WorkerPhase.OPENING:
                return self.opening_s
            case WorkerPhase.CLOSING:
                return self.closing_s
            case WorkerPhase.WAITING:
                return self.max_retry_s + self.heartbeat_s
            case WorkerPhase.STARTING | WorkerPhase.STREAMING:
                return self.heartbeat_s
