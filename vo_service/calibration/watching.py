"""Watching live what the camera sees of the board, where somebody wants to."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from vo_service.calibration.board import Corners
from vo_service.calibration.snapshot import Snapshot, View
from vo_service.outputs.worker import DropOldest, Worker

if TYPE_CHECKING:
    from vo_service.calibration.rerun_board import BoardScene

# For a viewer to take the last of its data.
CLOSING_S = 2.5
NEWEST = 2  # sights that may wait to be drawn


@dataclass(frozen=True)
class Sight:
    """One snapshot with the corners found in it, the views taken so far, and what to do next."""

    snapshot: Snapshot
    corners: Corners
    views: tuple[View, ...]
    advice: str


class Watcher(Protocol):
    """Somebody who may be watching."""

    def show(self, sight: Sight) -> None:
        """Show it, soon; never blocks."""
        ...


class Nobody:
    """Nobody is watching."""

    def show(self, sight: Sight) -> None:
        """Nothing to show."""


class RerunWatcher:
    """Somebody at a Rerun viewer, fed with the newest by a thread of its own.

    Raises InputError if Rerun is not installed or the target is none.
    """

    def __init__(self, target: str) -> None:
        # Rerun is an extra: calibrating runs without it.
        from vo_service.viewer.targets import prepare_rerun, sink_of

        self._sink = sink_of(target)
        prepare_rerun()
        scene: BoardScene = import_module("vo_service.calibration.rerun_board").open_board(
            self._sink
        )
        self.address = self._sink.address
        queue: DropOldest[Sight] = DropOldest(NEWEST)
        self._worker = Worker("rerun", queue, scene.log, scene.finish)

    def show(self, sight: Sight) -> None:
        """Draw it, unless something newer comes first."""
        self._worker.put(sight)

    def close(self) -> None:
        """Finish. A viewer that does not answer is left after a few seconds."""
        self._worker.close(CLOSING_S)
        self._sink.close()


@contextmanager
def watching(target: str | None, tell: Callable[[str], None]) -> Iterator[Watcher]:
    """Whoever watches at a target; None is nobody. `tell` gets the address to open."""
    if target is None:
        yield Nobody()
        return
    with closing(RerunWatcher(target)) as watcher:
        tell(f"pictures: {watcher.address}")
        yield watcher
