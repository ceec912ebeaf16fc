"""What a worker process runs, and its limits."""

from dataclasses import dataclass
from typing import Protocol

# How long the service waits for the end of a process that finishes alone.
FINISHING_TIMEOUT_S = 1.5


@dataclass(frozen=True)
class WorkerSpec:
    """What a worker process runs, and its limits.

    Attributes:
        function: "MODULE:FUNCTION". The process calls it with its `ServiceConnection`.
        name: Name in the log.
        start_timeout_s: Longest time to the first heartbeat.
        heartbeat_timeout_s: Longest time between two heartbeats. After it the process is killed.
        exit_timeout_s: Longest time to end, when asked to or when the service has ended. After it
            the process is killed.
        finishes_alone: The service does not wait for the end of the process, which may still write
            data. It also prints to the service's stderr, since nobody may be left to log that.
        orphan_timeout_s: Longest time until a process whose native code holds the GIL is killed
            when the service has ended.
        nice: Added to its niceness: poses have priority if CPUs are scarce.
        oom_score_adj: How readily the kernel kills it when memory runs out: at most 1000.
        memory_mb: Its memory limit; 0 = none.
        memory_key: The configuration key of the memory limit, for the message.
    """

    function: str
    name: str
    start_timeout_s: float = 60.0
    heartbeat_timeout_s: float = 120.0
    exit_timeout_s: float = 1.5
    finishes_alone: bool = False
    orphan_timeout_s: float = 20.0
    nice: int = 0
    oom_score_adj: int | None = None
    memory_mb: int = 0
    memory_key: str = ""

    @property
    def closing_timeout_s(self) -> float:
        """How long the service waits for the end of the process."""
        return FINISHING_TIMEOUT_S if self.finishes_alone else self.exit_timeout_s


class WorkerConfig(Protocol):
    """What a worker is to do. It is sent to the process as a part of the first message."""

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that the process inherits, with the same numbers."""
        ...
