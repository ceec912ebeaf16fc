"""Notices that a stream never begins, or stops."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.freenect.faults import never_began, stalled
from drivers.freenect.log import StreamHealth


@dataclass(frozen=True)
class Patience:
    """How long to wait, for each stream, in seconds: for its first image, for the next one."""

    first_s: float
    next_s: float


class Watchdog:
    """Watches streams by name, started at `started_s` (CLOCK_MONOTONIC)."""

    def __init__(
        self, streams: Mapping[str, StreamHealth], patience: Patience, started_s: float
    ) -> None:
        self._streams, self._patience, self._started_s = streams, patience, started_s

    @property
    def due_s(self) -> float:
        """When `check` is to be asked: nothing can be amiss before."""
        return min(self._due_s(stream) for stream in self._streams.values())

    def check(self, now_s: float) -> None:
        """Raises CameraLostError if a stream has been silent for too long."""
        for name, stream in self._streams.items():
            if now_s < self._due_s(stream):
                continue
            if stream.heard_s:
                raise stalled(name, self._patience.next_s)
            raise never_began(name, self._patience.first_s)

    def _due_s(self, stream: StreamHealth) -> float:
        if stream.heard_s:
            return stream.heard_s + self._patience.next_s
        return self._started_s + self._patience.first_s
