"""The renderer's process: ``python -m drivers.synthetic.render_worker FD``.

It renders the missing frames in the order in which the reader needs them. It ends when no frame is
missing or when its parent process ends.
"""

import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from drivers.core import CameraError
from drivers.core.memory import release_memory
from drivers.core.process.service_connection import ServiceConnection
from drivers.synthetic.rendered_sequence import (
    ReaderPosition,
    RenderedSequence,
    RenderingComplete,
    RenderJob,
    RenderRequest,
)
from drivers.synthetic.renderer import make_renderer


class RenderSchedule:
    """Assigns the missing frames of a sequence, each once, to any number of threads.

    In lockstep (`rate_hz` 0) the reader waits, so frames are rendered in order. A live reader does
    not wait: frames that cannot be ready in time are rendered later.
    """

    def __init__(
        self,
        sequence: RenderedSequence,
        rate_hz: float,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sequence = sequence
        self._rate_hz = rate_hz
        self._now_s = now_s
        self._lock = threading.Lock()
        self._urgent: deque[int] = deque()
        self._started_s: dict[int, float] = {}  # start times of the frames being rendered
        self._reader = (0, math.inf)  # index of the reader's next frame, and when it was reported
        self._render_s = 0.0  # duration of the last frame's rendering

    def set_reader_position(self, index: int) -> None:
        """Report the frame that the reader needs next."""
        self._reader = (index, self._now_s())

    def add_urgent(self, index: int) -> None:
        """Render this frame before all others."""
        self._urgent.append(index)

    def next_frame(self) -> int | None:
        """Take the frame to render now; None if none is missing."""
        with self._lock:
            now_s = self._now_s()
            index = self._select_next(now_s)
            if index is not None:
                self._started_s[index] = now_s
            return index

    def mark_rendered(self, index: int) -> None:
        """Report that a frame from `next_frame` has been written."""
        with self._lock:
            self._render_s = self._now_s() - self._started_s.pop(index)

    def _select_next(self, now_s: float) -> int | None:
        while self._urgent:
            index = self._urgent.popleft()
            if index not in self._started_s and not self._sequence.is_rendered(index):
                return index
        missing = [int(i) for i in self._sequence.missing_frames() if i not in self._started_s]
        first = self._first_feasible(now_s)
        return next((i for i in missing if i >= first), missing[0] if missing else None)

    def _first_feasible(self, now_s: float) -> int:
        """The first frame that can be ready before the reader needs it."""
        index, since_s = self._reader
        ahead_s = max(0.0, now_s - since_s) + self._render_s
        return min(index + int(ahead_s * self._rate_hz), self._sequence.files.count - 1)


def run_renderer(service: ServiceConnection) -> None:
    """Render until no frame is missing.

    Raises:
        UserFacingError: A frame cannot be rendered or stored.
    """
    job: RenderJob = service.config
    try:
        _render_missing(job, service)
    except OSError as error:
        raise CameraError(
            f"{job.files.frames}: cannot store frames: {error.strerror or error}"
        ) from error


def _render_missing(job: RenderJob, service: ServiceConnection) -> None:
    """Render the missing frames. Raises UserFacingError, and OSError for the disk."""
    sequence = RenderedSequence(job.files)
    schedule = RenderSchedule(sequence, job.rate_hz)
    threading.Thread(target=_receive_requests, args=(service, schedule), daemon=True).start()
    renderer = make_renderer(job.config, job.threads, job.files.folder)

    def render_next() -> bool:
        index = schedule.next_frame()
        if index is None:
            return False
        sequence.write(index, renderer.render(index))
        schedule.mark_rendered(index)
        os.eventfd_write(job.wake_fd, 1)
        return True

    def render_all() -> None:
        while render_next():
            pass

    render_next()  # compiles all kernels
    release_memory()
    # One processor is left to a live reader.
    threads = max(1, job.threads - 1) if job.rate_hz else job.threads
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(render_all) for _ in range(threads - 1)]
        render_all()  # here, because another thread would hold as much freed memory again
        for future in futures:
            future.result()
    service.send(RenderingComplete())


def _receive_requests(service: ServiceConnection, schedule: RenderSchedule) -> None:
    """Receive the reader's requests, in a thread; end the process when the reader is gone."""
    for message in service.messages():
        match message:
            case ReaderPosition(index):
                schedule.set_reader_position(index)
            case RenderRequest(index):
                schedule.add_urgent(index)
    os._exit(1)  # at once: a half-written frame is not marked as rendered
