"""Watching a map while it grows, where somebody wants to."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from drivers.camera import Pace, PinholeCamera
from drivers.geometry import Array
from vo_service.mapping.mesh import Mesh
from vo_service.outputs.worker import Worker

if TYPE_CHECKING:
    from vo_service.mapping.rerun_map import MapScene

# For a viewer to take the last of its data.
CLOSING_S = 5.0


@dataclass(frozen=True)
class MapSoFar:
    """The surface, and where the camera has been: (N, 3) in the world."""

    mesh: Mesh
    path_m: Array


@dataclass(frozen=True)
class Sight:
    """What there is after the frame `seq`: the same `so_far` as before, or a new one."""

    seq: int
    camera: PinholeCamera
    T_world_camera: Array
    so_far: MapSoFar


class Watcher(Protocol):
    """Somebody who may be watching."""

    @property
    def is_watching(self) -> bool:
        """Whether a mesh is worth making."""
        ...

    def show(self, sight: Sight) -> None:
        """Show it, soon."""
        ...


class Nobody:
    """Nobody is watching."""

    is_watching = False

    def show(self, sight: Sight) -> None:
        """Nothing to show."""


class Everybody:
    """All who watch, in one or several places."""

    is_watching = True

    def __init__(self, watchers: list["RerunWatcher"]) -> None:
        self._watchers = watchers

    def show(self, sight: Sight) -> None:
        """Show it to each."""
        for watcher in self._watchers:
            watcher.show(sight)


class RerunWatcher:
    """One place of Rerun's, fed by a thread of its own: a viewer gets the newest, a file all.

    Raises InputError if Rerun is not installed or the target is none, UserFacingError if a port is
    taken.
    """

    def __init__(self, target: str) -> None:
        # Rerun is an extra: maps are made without it.
        from vo_service.viewer.targets import prepare_rerun, sink_of

        self._sink = sink_of(target)
        prepare_rerun()
        scene: MapScene = import_module("vo_service.mapping.rerun_map").open_map(self._sink)
        self.address = self._sink.address
        queue = self._sink.hand_over(Pace.LOCKSTEP)
        self._worker: Worker[Sight] = Worker("rerun", queue, scene.log, scene.finish)

    def show(self, sight: Sight) -> None:
        """Draw it; for a viewer, unless something newer comes first."""
        self._worker.put(sight)

    def close(self) -> None:
        """Finish. A viewer that does not answer is left after a few seconds."""
        self._worker.close(CLOSING_S)
        self._sink.close()


@contextmanager
def watching(targets: tuple[str, ...], tell: Callable[[str], None]) -> Iterator[Watcher]:
    """Whoever watches at these targets. `tell` gets the addresses to open.

    Raises what `RerunWatcher` raises, and InputError if two targets are the same place.
    """
    if not targets:
        yield Nobody()
        return
    from vo_service.viewer.targets import check_places

    check_places(targets)
    with ExitStack() as stack:
        watchers = []
        for target in targets:
            watcher = RerunWatcher(target)
            stack.callback(watcher.close)
            tell(f"pictures: {watcher.address}")
            watchers.append(watcher)
        yield Everybody(watchers)
