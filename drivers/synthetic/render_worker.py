"""The renderer's process: ``python -m drivers.synthetic.render_worker FD``.

It renders the frames that are missing, in the order in which they are needed, and ends when there
are none or when the process that started it is gone.
"""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2

from drivers.errors import CameraError, UserFacingError
from drivers.isolation.outbox import Outbox, leave_signals_to_service
from drivers.memory import release_memory
from drivers.synthetic.render import make_renderer
from drivers.synthetic.render_messages import (
    AllRendered,
    ReaderIsAt,
    RenderingFailed,
    RenderJob,
    RenderNow,
)
from drivers.synthetic.render_schedule import RenderSchedule
from drivers.synthetic.rendered_sequence import RenderedSequence

# Live readers of the frames come first.
NICE = 10


def main(connection: "Connection[Any, Any]") -> None:
    """Render until no frame is missing."""
    leave_signals_to_service()
    os.nice(NICE)
    cv2.setNumThreads(1)
    job: RenderJob = connection.recv()
    outbox = Outbox(connection)
    try:
        _render_missing(job, connection, outbox)
    except UserFacingError as error:
        outbox.tell(RenderingFailed(error))
    except OSError as error:
        message = f"{job.files.frames}: frames cannot be kept: {error.strerror or error}"
        outbox.tell(RenderingFailed(CameraError(message)))


def _render_missing(job: RenderJob, connection: "Connection[Any, Any]", outbox: Outbox) -> None:
    """Raises UserFacingError if the configuration cannot be rendered, OSError for the disk."""
    sequence = RenderedSequence(job.files)
    schedule = RenderSchedule(sequence, job.rate_hz)
    threading.Thread(target=_listen, args=(connection, schedule), daemon=True).start()
    renderer = make_renderer(job.config, job.threads, job.files.folder)

    def render_next() -> bool:
        index = schedule.take()
        if index is None:
            return False
        sequence.write(index, renderer.render(index))
        schedule.finish(index)
        os.eventfd_write(job.wake, 1)
        return True

    def render_all() -> None:
        while render_next():
            pass

    render_next()  # with it, all kernels are there
    release_memory()
    # A live reader has work to do meanwhile: one processor is left to it.
    threads = max(1, job.threads - 1) if job.rate_hz else job.threads
    with ThreadPoolExecutor(threads) as pool:
        others = [pool.submit(render_all) for _ in range(threads - 1)]
        render_all()  # a thread more would hold as much freed memory again
        for done in others:
            done.result()
    outbox.tell(AllRendered())


def _listen(connection: "Connection[Any, Any]", schedule: RenderSchedule) -> None:
    """Body of the thread that hears what the reader needs, and ends the process with it."""
    with suppress(EOFError, OSError):
        while True:
            match connection.recv():
                case ReaderIsAt(index):
                    schedule.reader_is_at(index)
                case RenderNow(index):
                    schedule.add_urgent(index)
    os._exit(1)  # at once: a frame that is half-written does not count


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
