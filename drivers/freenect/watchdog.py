"""Detection of a stream that does not start, or stops."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.freenect.error_messages import stream_not_started_error, stream_stalled_error
from drivers.freenect.libfreenect_log import StreamHealth


@dataclass(frozen=True)
class StreamTimeouts:
    """Time limits for the first and for the next image of each stream."""

    first_image_s: float
    next_image_s: float


class StreamWatchdog:
    """Checks the activity of named streams that were started at `started_s` (CLOCK_MONOTONIC)."""

    def __init__(
        self, streams: Mapping[str, StreamHealth], timeouts: StreamTimeouts, started_s: float
    ) -> None:
        self._streams, self._timeouts, self._started_s = streams, timeouts, started_s

    @property
    def due_s(self) -> float:
        """The earliest time at which `check` can fail."""
        return min(self._due_s(stream) for stream in self._streams.values())

    def check(self, now_s: float) -> None:
        """Raise CameraLostError if a stream has been silent for too long."""
        for name, stream in self._streams.items():
            if now_s < self._due_s(stream):
                continue
            if stream.last_activity_s:
                raise stream_stalled_error(name, self._timeouts.next_image_s)
            raise stream_not_started_error(name, self._timeouts.first_image_s)

    def _due_s(self, stream: StreamHealth) -> float:
        if stream.last_activity_s:
            return stream.last_activity_s + self._timeouts.next_image_s
        return self._started_s + self._timeouts.first_image_s
