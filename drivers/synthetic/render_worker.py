"""The renderer's process.

It renders the missing frames in the order in which the reader needs them. It ends when no frame is
missing or when its parent process ends.
"""

import os
import threading
from concurrent.futures import ThreadPoolExecutor

from drivers.core.errors import CameraError
from drivers.core.memory import release_memory
from drivers.core.process.service_connection import ServiceConnection
from drivers.synthetic.render_messages import (
    ReaderPosition,
    RenderingComplete,
    RenderJob,
    RenderRequest,
)
from drivers.synthetic.render_schedule import RenderSchedule
from drivers.synthetic.rendered_sequence import RenderedSequence
from drivers.synthetic.renderer import make_renderer


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
