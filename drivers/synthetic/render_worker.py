"""The renderer's process: ``python -m drivers.synthetic.render_worker FD``.

It renders the missing frames in the order in which the reader needs them. It ends when no frame is
missing or when its parent process ends.
"""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2

from drivers.core.errors import CameraError, UserFacingError
from drivers.core.memory import release_memory
from drivers.core.process.parent_connection import ParentConnection, ignore_terminal_signals
from drivers.synthetic.render_messages import (
    ReaderPosition,
    RenderingComplete,
    RenderingFailed,
    RenderJob,
    RenderRequest,
)
from drivers.synthetic.render_schedule import RenderSchedule
from drivers.synthetic.rendered_sequence import RenderedSequence
from drivers.synthetic.renderer import make_renderer

# Live readers of the frames have priority.
NICENESS = 10


def main(connection: "Connection[Any, Any]") -> None:
    """Render until no frame is missing."""
    ignore_terminal_signals()
    os.nice(NICENESS)
    cv2.setNumThreads(1)
    job: RenderJob = connection.recv()
    outbox = ParentConnection(connection)
    try:
        _render_missing(job, connection, outbox)
    except UserFacingError as error:
        outbox.send(RenderingFailed(error))
    except OSError as error:
        message = f"{job.files.frames}: cannot store frames: {error.strerror or error}"
        outbox.send(RenderingFailed(CameraError(message)))


def _render_missing(
    job: RenderJob, connection: "Connection[Any, Any]", outbox: ParentConnection
) -> None:
    """Render the missing frames. Raises UserFacingError, and OSError for the disk."""
    sequence = RenderedSequence(job.files)
    schedule = RenderSchedule(sequence, job.rate_hz)
    threading.Thread(target=_receive_requests, args=(connection, schedule), daemon=True).start()
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
    outbox.send(RenderingComplete())


def _receive_requests(connection: "Connection[Any, Any]", schedule: RenderSchedule) -> None:
    """Receive the reader's requests, in a thread; end the process when the reader is gone."""
    with suppress(EOFError, OSError):
        while True:
            match connection.recv():
                case ReaderPosition(index):
                    schedule.set_reader_position(index)
                case RenderRequest(index):
                    schedule.add_urgent(index)
    os._exit(1)  # at once: a half-written frame is not marked as rendered


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
