"""The loop on a thread of its own; the main thread is left to the signals."""

import logging
import threading
from collections.abc import Callable

from vo_service.interrupts import ReloadSignal, StopSignal

# How soon a signal is heeded.
SIGNAL_POLL_S = 0.1
# How long the loop may take for the frame at hand once it is to end.
LOOP_STOP_TIMEOUT_S = 2.5

logger = logging.getLogger(__name__)


class _LoopThread(threading.Thread):
    """Runs `work`, and keeps what it raised."""

    def __init__(self, work: Callable[[threading.Event], None], stop: threading.Event) -> None:
        # A daemon: a native call that never returns must not keep the process from ending.
        super().__init__(name="odometry", daemon=True)
        self.is_over = threading.Event()
        self.error: BaseException | None = None
        self._work, self._stop_event = work, stop

    def run(self) -> None:
        """Body of the thread."""
        try:
            self._work(self._stop_event)
        except BaseException as error:
            self.error = error
        finally:
            self.is_over.set()


def run_on_loop_thread(
    work: Callable[[threading.Event], None],
    stop: StopSignal,
    reload_signal: ReloadSignal,
    on_reload: Callable[[], None],
) -> None:
    """Run `work` on a thread of its own until it ends; call `reload` here after each hangup.

    Raises what `work` raises. Work that does not end in time once it is asked to is left behind.
    """
    loop = _LoopThread(work, stop.event)
    loop.start()
    try:
        # Not `join`: an event can be waited for again after a signal has interrupted it.
        while not loop.is_over.wait(SIGNAL_POLL_S) and not stop.event.is_set():
            if reload_signal.is_set():
                reload_signal.clear()
                on_reload()
    finally:
        stop.request()
        if not loop.is_over.wait(LOOP_STOP_TIMEOUT_S):
            logger.error("the odometry did not come to an end within %g s", LOOP_STOP_TIMEOUT_S)
    if loop.error is not None:
        raise loop.error
