"""Frames of the virtual Kinect that a process renders ahead of the reader."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

from drivers.core import CameraLostError
from drivers.core.process.messages import WorkerFailed
from drivers.core.process.worker_process import WorkerProcess
from drivers.core.process.worker_spec import WorkerSpec
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.rendered_sequence import (
    ReaderPosition,
    RenderedSequence,
    RenderingComplete,
    RenderJob,
    RenderRequest,
    create_sequence,
    files_for_config,
)
from drivers.synthetic.sensors import RenderedImages

# Live readers of the frames have priority.
RENDERER = WorkerSpec("drivers.synthetic.render_worker:run_renderer", "renderer", nice=10)
# A frame takes a second on a slow board; the room is painted before the first one.
MAX_FRAME_S = 120.0

RenderProgress = Callable[[int, int], None]  # frames rendered, total frames


class FrameProvider:
    """Provides the frames of a configuration in a loop, frame 0 after the last.

    A separate process renders them ahead of the reader and stores them on disk; it runs while
    frames are missing. A live reader (`rate_hz` above 0) gets the frames that are rendered in time.

    Args:
        folder: Where frames are stored.
        rate_hz: Frame rate of a live reader; 0 in lockstep.
        threads: Rendering threads; 0 for one per core.

    Raises:
        InputError: There are too many frames to store, or the track cannot be read.
    """

    def __init__(self, config: SyntheticConfig, folder: Path, rate_hz: float, threads: int) -> None:
        self._files = files_for_config(config, folder)
        self._job = RenderJob(
            config, self._files, rate_hz, threads or os.cpu_count() or 1, wake_fd=-1
        )
        self._resources = ExitStack()
        self._wake_fd = -1  # eventfd: the process has written a frame
        self._sequence: RenderedSequence | None = None
        self._process: WorkerProcess | None = None

    def start(self) -> None:
        """Start providing frames. Returns at once; a running process continues."""
        if self._process is not None:
            return
        self.close()
        self._sequence = create_sequence(self._files)
        self._resources.callback(self._sequence.close)
        self._wake_fd = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._resources.callback(os.close, self._wake_fd)
        if self._sequence.missing_frames().size:
            self._ensure_process()

    def wait_until_started(self, timeout_s: float) -> bool:
        """Wait until the first frame is rendered. Raises as `wait_for_newest`."""
        return self._wait_for(0, 0, timeout_s) is not None

    def wait_for_newest(self, first: int, last: int, timeout_s: float) -> int | None:
        """Wait for the newest rendered frame from `first` to `last`.

        Returns:
            Its number; None if none of them is rendered after `timeout_s`.

        Raises:
            InputError, CameraError: Rendering failed.
        """
        if self._process is not None:
            self._process.send(ReaderPosition(last % self._files.count))
            self._receive(0.0)
        return self._wait_for(first, last, timeout_s)

    def read(self, seq: int) -> RenderedImages:
        """Read a frame; wait if it is not rendered yet. Raises as `wait_for_newest`."""
        index = seq % self._files.count
        deadline_s = time.monotonic() + MAX_FRAME_S
        while (images := self._open_sequence.read(index)) is None:
            if time.monotonic() > deadline_s:
                raise CameraLostError(f"synthetic camera: frame {index} was not rendered in time")
            self._ensure_process().send(RenderRequest(index))
            self._wait_for(seq, seq, 1.0)
        return images

    def wait_until_complete(self, progress: RenderProgress) -> None:
        """Wait until no frame is missing. Raises as `wait_for_newest` and `progress`."""
        while missing := self._open_sequence.missing_frames().size:
            progress(self._files.count - missing, self._files.count)
            self._receive(0.1)

    def close(self) -> None:
        """Stop. Safe to call twice."""
        self._stop_process()
        self._resources.close()
        self._sequence = None

    @property
    def _open_sequence(self) -> RenderedSequence:
        if self._sequence is None:
            raise CameraLostError("synthetic camera: not open; open it again")
        return self._sequence

    def _wait_for(self, first: int, last: int, timeout_s: float) -> int | None:
        deadline_s = time.monotonic() + timeout_s
        while True:
            for seq in range(last, max(first, last - self._files.count + 1) - 1, -1):
                if self._open_sequence.is_rendered(seq % self._files.count):
                    return seq
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0.0:
                return None
            self._receive(remaining_s)

    def _ensure_process(self) -> WorkerProcess:
        """Return the renderer's process; start it if needed. Raises CameraLostError."""
        if self._process is None:
            try:
                job = replace(self._job, wake_fd=self._wake_fd)
                self._process = WorkerProcess(RENDERER, job)
            except OSError as error:
                raise CameraLostError(
                    f"synthetic camera: cannot start the renderer: {error.strerror}"
                ) from error
        return self._process

    def _stop_process(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()  # the frames that it has written stay valid
            with process:
                pass  # the exit reaps it

    def _receive(self, timeout_s: float) -> None:
        """Wait until the process has written a frame. Raises InputError or CameraError."""
        process = self._ensure_process()  # it has ended if all frames were rendered before
        try:
            message = process.receive(timeout_s, self._wake_fd)
            with suppress(BlockingIOError):
                os.eventfd_read(self._wake_fd)
        except EOFError:
            self._stop_process()
            raise CameraLostError(f"synthetic camera: the renderer {process.exit_reason}") from None
        match message:
            case RenderingComplete():
                self._stop_process()
            case WorkerFailed(error):
                self._stop_process()
                raise error


def render_all(
    config: SyntheticConfig, folder: Path, progress: RenderProgress, threads: int = 0
) -> RenderedSequence:
    """Render the missing frames of a configuration and open the sequence.

    Args:
        progress: Called about ten times a second.
        threads: Rendering threads; 0 for one per core.

    Raises:
        InputError, CameraError: Rendering failed; also whatever `progress` raises.
    """
    provider = FrameProvider(config, folder, 0.0, threads)
    try:
        provider.start()
        provider.wait_until_complete(progress)
    finally:
        provider.close()
    return create_sequence(files_for_config(config, folder))
