"""The last seconds of frames and statuses in shared memory."""

import json
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drivers.core.files import MEGABYTE
from drivers.core.process.record_ring import RecordRingWriter
from vo_service.frame_packing import compile_kernels, write_frame
from vo_service.types.messages import Status
from vo_service.types.odometry_update import UpdateWithWheels

STATUS_RING_S = 60.0
STATUS_RING_BYTES = 1_000_000


@dataclass(frozen=True)
class StampedStatus:
    """A status with its time on CLOCK_REALTIME and CLOCK_MONOTONIC."""

    status: Status
    unix_s: float
    monotonic_s: float

    @classmethod
    def now(cls, status: Status) -> "StampedStatus":
        """Stamp a status with the current time."""
        return cls(status, time.time(), time.monotonic())


class FrameHistory:
    """Writer of both rings, for one thread."""

    def __init__(self, seconds: float, max_mb: int) -> None:
        """Allocate the rings.

        Raises:
            OSError: If there is no memory.
        """
        self.frames = RecordRingWriter("recorder-frames", seconds, max_mb * MEGABYTE)
        try:
            self.statuses = RecordRingWriter("recorder-statuses", STATUS_RING_S, STATUS_RING_BYTES)
        except OSError:
            self.frames.close()
            raise
        compile_kernels()

    def append(self, item: UpdateWithWheels | StampedStatus, missed: int) -> None:
        """Append an item. `missed` counts dropped items.

        Raises:
            OSError: If there is no memory.
        """
        if isinstance(item, UpdateWithWheels):
            write_frame(self.frames, item.update, odometry=item.wheel_messages)
        else:
            self._put_status(item, missed)

    def close(self) -> None:
        """Release the memory."""
        with suppress(BufferError):  # a reader still holds a buffer; the process ends soon
            self.frames.close()
            self.statuses.close()

    def _put_status(self, stamped: StampedStatus, missed: int) -> None:
        content = {
            "unix_s": stamped.unix_s,
            "monotonic_s": stamped.monotonic_s,
            **asdict(stamped.status),
            "recorder": self._ring_stats(missed),
        }
        line = json.dumps(content).encode()
        buffer = self.statuses.reserve(len(line), stamped.monotonic_s)
        buffer[: len(line)] = np.frombuffer(line, np.uint8)
        self.statuses.commit(len(line), b"", len(line), stamped.monotonic_s)

    def _ring_stats(self, missed: int) -> dict[str, Any]:
        return {
            "frames": self.frames.record_count,
            "missed": missed,
            "ring_mb": round(self.frames.used_bytes / MEGABYTE, 1),
            "limited_by": "max_mb" if self.frames.is_limited_by_bytes else "seconds",
        }
