"""What the service asks of a mapper, and what stands in for one."""

from dataclasses import dataclass
from typing import Protocol

from vo_service.control.errors import CommandError, ErrorCode
from vo_service.mapping.loops.contract import Loops, NoLoops
from vo_service.outputs.output import Output, PoseUpdate, Status
from vo_service.settings import MapSettings


@dataclass(frozen=True)
class MapState:
    """What there is to say of the map.

    keyframes  that it would be made of now
    saving     file of the map that is being made; "" = none
    saved      file of the last map that was made whole; "" = none
    loading    file of the map whose places are being loaded; "" = none
    loaded     file of the map whose places are known; "" = none
    """

    keyframes: int = 0
    saving: str = ""
    saved: str = ""
    loading: str = ""
    loaded: str = ""


class Mapper(Output, Protocol):
    """An output that remembers where the camera has been, and can make a map of it.

    loops  which places are known again
    """

    loops: Loops

    @property
    def state(self) -> MapState:
        """How it is now."""
        ...

    def save(self, name: str) -> MapState:
        """Begin to make a map of this name; the state from then on.

        Raises CommandError if the name will not do, or if it is not possible now.
        """
        ...

    def load(self, name: str) -> MapState:
        """Begin to know the places of the map of this name; the state from then on.

        Raises CommandError if there is none, or if it is not possible now.
        """
        ...

    def configure(self, settings: MapSettings) -> None:
        """Take over what may change while it runs: all but `enabled`, `loops` and `load`."""
        ...


class NoMapper:
    """Where there is to be no map, or can be none: says why to whoever asks."""

    state = MapState()
    loops: Loops = NoLoops()

    def __init__(self, reason: str = "there is no map", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def pose(self, update: PoseUpdate) -> None:
        """Nothing to remember."""

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, name: str) -> MapState:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def load(self, name: str) -> MapState:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def configure(self, settings: MapSettings) -> None:
        """Nothing to change."""

    def close(self) -> None:
        """Nothing to release."""
