"""Time limits of a worker process in each phase, and the delay between retries."""

from dataclasses import dataclass
from enum import StrEnum


class WorkerPhase(StrEnum):
    """What the worker is doing; each phase has its own time limit."""

    LAUNCHING = "starting up"
    OPENING = "opening the camera"
    STARTING = "waiting for the first frame"
    STREAMING = "reading frames"
    CLOSING = "closing the camera"
    WAITING = "waiting to open the camera again"


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
    initial_retry_s: float = 0.2
    max_retry_s: float = 1.5
    orphan_s: float = 10.0

    def heartbeat_timeout_s(self, phase: WorkerPhase) -> float:
        """Return the longest time without a message in this phase."""
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
