"""When two worlds are one: after a loss, or a restart, nothing is known of how they lie."""

from dataclasses import dataclass

from drivers.geometry import Array, are_near, inverse
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.places.place import Place

# Two loops agree about how two worlds lie to each other to within this.
AGREED_M, AGREED_RAD = 0.10, 0.05


@dataclass(frozen=True, eq=False)
class _Opinion:
    """A loop between two worlds, and how these lie to each other if it is right."""

    loop: Edge
    worlds: tuple[int, int]
    T_old_new: Array


class Joining:
    """Waits for a second opinion: one loop between two worlds is not believed."""

    def __init__(self) -> None:
        self._waiting: list[_Opinion] = []

    def take(self, loop: Edge, old: Place, new: Place) -> list[Edge]:
        """The loops to be closed now: none, or this one and those that waited for it.

        loop  from the old place to the new one
        """
        T_old_new = old.T_world_place @ loop.T_a_b @ inverse(new.T_world_place)
        opinion = _Opinion(loop, (old.world, new.world), T_old_new)
        others = [each for each in self._waiting if each.worlds == opinion.worlds]
        agreed = [
            each for each in others if are_near(each.T_old_new, T_old_new, AGREED_M, AGREED_RAD)
        ]
        settled = others if agreed else []
        self._waiting = [each for each in self._waiting if each not in settled]
        if agreed:
            return [*(each.loop for each in agreed), loop]
        self._waiting.append(opinion)
        return []
