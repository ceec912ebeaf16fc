"""Where the virtual Kinect's frames come from: rendered when they are read, or ahead of that."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from drivers.core.errors import CameraLostError
from drivers.core.process.worker_process import WorkerProcess, WorkerSpec
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.fault_injection import RenderedImages
from drivers.synthetic.render_messages import (
    ReaderPosition,
    RenderingComplete,
    RenderingFailed,
    RenderJob,
    RenderRequest,
)
from drivers.synthetic.rendered_sequence import RenderedSequence, create_sequence, files_for_config

if TYPE_CHECKING:  # its kernels are slow to load, and a renderer in a process of its own has them
    from drivers.synthetic.renderer import Renderer

RENDERER = WorkerSpec("drivers.synthetic.render_worker", "renderer")
# It is killed rather than waited for: what it has written stays.
STOP_TIMEOUT_S = 2.0
# A single frame takes a second on a slow board; the first one is preceded by painting the room.
MAX_FRAME_S = 120.0

RenderProgress = Callable[[int, int], None]  # frames done, frames in all


class FrameProvider(Protocol):
    """The frames of a configuration, which is played round and round: frame 0 follows the last."""

    def prepare(self) -> None:
        """Begin what can be done in the background. Raises as `start`."""
        ...

    def start(self) -> None:
        """Begin. Raises InputError or CameraError if it cannot."""
        ...

    def wait_until_started(self, timeout_s: float) -> bool:
        """Wait until the first frame is there. Raises as `newest`."""
        ...

    def wait_for_newest(self, first: int, last: int, timeout_s: float) -> int | None:
        """The newest frame from `first` to `last` that is rendered; waits for one of them.

        None if there is none after `timeout_s`. Raises InputError or CameraError if none will come.
        """
        ...

    def read(self, seq: int) -> RenderedImages:
        """A frame, whether or not it is rendered already. Raises as `newest`."""
        ...

    def close(self) -> None:
        """Stop. Safe to call twice."""
        ...


class OnDemandFrameProvider:
    """Renders each frame when it is read, and keeps none."""

    def __init__(self, config: SyntheticConfig, threads: int) -> None:
        self._config = config
        self._threads = threads or os.cpu_count() or 1
        self._renderers: list[Renderer] = []

    def prepare(self) -> None:
        """See `FrameProvider`: nothing is done in the background."""

    def start(self) -> None:
        """Paint the room, the first time."""
        from drivers.synthetic.renderer import make_renderer

        if not self._renderers:
            self._renderers.append(make_renderer(self._config, self._threads))

    def wait_until_started(self, timeout_s: float) -> bool:
        """See `FrameProvider`."""
        return True

    def wait_for_newest(self, first: int, last: int, timeout_s: float) -> int | None:
        """See `FrameProvider`."""
        return last

    def read(self, seq: int) -> RenderedImages:
        """See `FrameProvider`."""
        return self._renderers[0].render(seq % self._config.frame_count)

    def close(self) -> None:
        """See `FrameProvider`."""


class BackgroundFrameProvider:
    """Frames that a process of its own renders ahead of the reader and that are kept on disk.

    The process runs while frames are missing. A live reader (`rate_hz` above 0) finds the frames
    that could be rendered in time.
    """

    def __init__(self, config: SyntheticConfig, folder: Path, rate_hz: float, threads: int) -> None:
        """Raises InputError if the frames are too many to keep or the track cannot be read."""
        self._files = files_for_config(config, folder)
        self._job = RenderJob(
            config, self._files, rate_hz, threads or os.cpu_count() or 1, wake_fd=-1
        )
        self._resources = ExitStack()
        self._wake_fd = -1  # eventfd: the process has written a frame
        self._sequence: RenderedSequence | None = None
        self._process: WorkerProcess | None = None

    def prepare(self) -> None:
        """See `FrameProvider`."""
        self.start()

    def start(self) -> None:
        """See `FrameProvider`. Returns at once; a process that is at work goes on."""
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
        """See `FrameProvider`."""
        return self._wait_for(0, 0, timeout_s) is not None

    def wait_for_newest(self, first: int, last: int, timeout_s: float) -> int | None:
        """See `FrameProvider`."""
        if self._process is not None:
            self._process.send(ReaderPosition(last % self._files.count))
            self._receive(0.0)
        return self._wait_for(first, last, timeout_s)

    def read(self, seq: int) -> RenderedImages:
        """See `FrameProvider`."""
        index = seq % self._files.count
        deadline_s = time.monotonic() + MAX_FRAME_S
        while (images := self._open_sequence.read(index)) is None:
            if time.monotonic() > deadline_s:
                raise CameraLostError(f"synthetic camera: frame {index} is not rendered in time")
            self._ensure_process().send(RenderRequest(index))
            self._wait_for(seq, seq, 1.0)
        return images

    def wait_until_complete(self, progress: RenderProgress) -> None:
        """Wait until no frame is missing. Raises as `newest`, and what `progress` raises."""
        while missing := self._open_sequence.missing_frames().size:
            progress(self._files.count - missing, self._files.count)
            self._receive(0.1)

    def close(self) -> None:
        """See `FrameProvider`."""
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
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                return None
            self._receive(left_s)

    def _ensure_process(self) -> WorkerProcess:
        """The process, started where there is none. Raises CameraLostError."""
        if self._process is None:
            try:
                self._process = WorkerProcess(RENDERER, (self._wake_fd,), STOP_TIMEOUT_S)
            except OSError as error:
                raise CameraLostError(
                    f"synthetic camera: the renderer cannot be started: {error.strerror}"
                ) from error
            self._process.send(replace(self._job, wake_fd=self._wake_fd))
        return self._process

    def _stop_process(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            with process:
                pass  # leaving it reaps it

    def _receive(self, timeout_s: float) -> None:
        """Wait until the process has written a frame. Raises InputError or CameraError."""
        process = self._ensure_process()  # it has ended where all frames were there once
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
            case RenderingFailed(error):
                self._stop_process()
                raise error


def render_all(
    config: SyntheticConfig, folder: Path, progress: RenderProgress, threads: int = 0
) -> RenderedSequence:
    """Render what is missing of a configuration, and open the result.

    Raises InputError or CameraError, and what `progress` raises.
    """
    rendering = BackgroundFrameProvider(config, folder, 0.0, threads)
    try:
        rendering.start()
        rendering.wait_until_complete(progress)
    finally:
        rendering.close()
    return create_sequence(files_for_config(config, folder))
