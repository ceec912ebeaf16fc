"""Progress of a download on a terminal; nothing in a log."""

import time
from collections.abc import Callable

from vo_service.terminal import REDRAW_S, Terminal


class DownloadProgress:
    """Progress line of one sequence, drawn at most ten times a second."""

    def __init__(
        self, terminal: Terminal, name: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._terminal, self._name, self._clock = terminal, name, clock
        self._begin_s, self._begin_bytes = clock(), -1
        self._drawn_s = 0.0

    def show_transfer(self, done: int, total: int | None) -> None:
        """Show the transferred bytes, of the total if it is known."""
        if self._begin_bytes < 0:  # data from an earlier download does not count as speed
            self._begin_s, self._begin_bytes = self._clock(), done
        elapsed_s = max(self._clock() - self._begin_s, 1e-3)
        rate = max(done - self._begin_bytes, 0) / elapsed_s
        text = f"{done / 1e6:.0f} MB"
        if total:
            text = f"{done / 1e6:.0f} of {total / 1e6:.0f} MB ({done / total:.0%})"
        text += f", {rate / 1e6:.1f} MB/s"
        if total and rate > 0:
            text += f", {_format_duration((total - done) / rate)} left"
        self._draw(text)

    def show_unpacking(self, done: int, total: int | None) -> None:
        """Show the fraction of the archive that has been unpacked."""
        self._draw(f"unpacking ({done / total:.0%})" if total else "unpacking")

    def _draw(self, text: str) -> None:
        now_s = self._clock()
        if now_s - self._drawn_s >= REDRAW_S:
            self._drawn_s = now_s
            self._terminal.show(f"{self._name}: {text}")


def _format_duration(seconds: float) -> str:
    minutes = round(seconds) // 60
    return f"{minutes} min" if minutes else f"{seconds:.0f} s"
