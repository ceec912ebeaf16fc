"""A camera whose `open` takes long, opened on a thread of its own: its reader never waits."""

import threading
import time
from collections.abc import Callable

from drivers.camera import (
    CameraCounters,
    CameraState,
    Condition,
    NoFrameYet,
    RgbdCamera,
    RgbdFrame,
)
from drivers.errors import CameraError
from drivers.trajectory import StampedPoses

# How long `close` waits for an `open` that was cancelled; the thread is then left to itself.
CANCEL_S = 2.0

Progress = Callable[[int, int], None]


class Cancelled(Exception):  # noqa: N818 (like StopIteration: not an error)
    """The opening is not wanted any more."""


class Cancellable:
    """Progress of an opening, passed on to somebody who shows it; it ends what is cancelled."""

    def __init__(self, show: Progress) -> None:
        self._show = show
        self.is_cancelled = threading.Event()

    def __call__(self, done: int, total: int) -> None:
        """Show it. Raises Cancelled."""
        if self.is_cancelled.is_set():
            raise Cancelled
        self._show(done, total)


class BackgroundOpening(RgbdCamera):
    """`open` returns at once; there is no frame until `camera` is open, and `condition` says why.

    What `camera.open` raises is raised by `read`.
    """

    def __init__(self, camera: RgbdCamera, progress: Cancellable, doing: str) -> None:
        """`camera` calls `progress` while it opens; `doing` says in words what takes so long."""
        self.name, self.clock = camera.name, camera.clock
        self._camera = camera
        self._progress = progress
        self._doing = doing
        self._is_settled = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread()

    def open(self) -> None:
        """Begin to open."""
        self.close()
        self._is_settled.clear()
        self._error = None
        self._progress.is_cancelled.clear()
        self._thread = threading.Thread(target=self._run, name="camera-opening", daemon=True)
        self._thread.start()

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`."""
        deadline_s = time.monotonic() + timeout_s
        if not self._is_settled.wait(timeout_s):
            raise NoFrameYet
        if self._error is not None:
            raise self._error
        return self._camera.read(max(0.0, deadline_s - time.monotonic()))

    def close(self) -> None:
        """See `RgbdCamera`; an opening that goes on is cancelled."""
        self._progress.is_cancelled.set()
        if self._thread.is_alive():
            self._thread.join(CANCEL_S)
        self._camera.close()

    @property
    def condition(self) -> Condition:
        """What goes on while it is opened, then as the camera says."""
        if not self._is_settled.is_set():
            return Condition(CameraState.OPENING, self._doing)
        return self._camera.condition

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`."""
        return self._camera.counters

    @property
    def frame_count(self) -> int | None:
        """See `RgbdCamera`."""
        return self._camera.frame_count

    @property
    def ground_truth(self) -> StampedPoses | None:
        """See `RgbdCamera`."""
        return self._camera.ground_truth

    def _run(self) -> None:
        """Body of the thread."""
        try:
            self._camera.open()
        except Cancelled:
            self._error = CameraError(f"{self.name}: closed while it was opened; open it again")
        except Exception as error:
            self._error = error
        finally:
            self._is_settled.set()
