"""The places of a map: which of them look like a view, and which one can be spared."""

from collections.abc import Callable, Iterator

import numpy as np

from drivers.geometry import Array
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.view import PlaceView

# Two places are as near as the sum of the way between them and of the turn, in these units.
NEAR_M, NEAR_RAD = 0.3, np.radians(20.0)


class Places:
    """Places by their numbers, which rise."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._places: dict[int, Place] = {}
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[Place]:
        return iter(self._places.values())

    def __getitem__(self, number: int) -> Place:
        return self._places[number]

    def __contains__(self, number: int) -> bool:
        return number in self._places

    @property
    def bytes(self) -> int:
        """What all of them take."""
        return self._bytes

    @property
    def is_over(self) -> bool:
        """Whether they take more than they may: `redundant` says which one to remove."""
        return self._bytes > self._most_bytes

    def add(self, place: Place) -> None:
        """Add one, of a higher number than any before."""
        if self._places and place.number <= next(reversed(self._places)):
            raise ValueError(f"place {place.number} is no newer than the others")
        self._places[place.number] = place
        self._bytes += place.bytes

    def remove(self, number: int) -> None:
        """Forget one. Raises KeyError if there is none of this number."""
        self._bytes -= self._places.pop(number).bytes

    def alike(self, view: PlaceView, count: int, allowed: Callable[[Place], bool]) -> list[Place]:
        """The places among those allowed that look most like a view, the most alike first."""
        places = [place for place in self if allowed(place)]
        if not places:
            return []
        summaries = np.stack([place.summary for place in places]).astype(np.float32)
        likeness = summaries @ view.summary.astype(np.float32)
        best = np.argsort(-likeness, kind="stable")[:count]
        return [places[n] for n in best]

    def redundant(self) -> int:
        """Number of the place that can best be spared: one that is near to others of its world.

        Of two that are nearest to each other it is the one that is nearer to a third. The first and
        the newest place are never spared. Raises ValueError with fewer than three places.
        """
        if len(self) < 3:
            raise ValueError("the first and the newest place are never spared")
        places = list(self)
        apart = distances(places)
        np.fill_diagonal(apart, np.inf)
        two_nearest = np.partition(apart, 1, axis=1)[:, :2]
        spared = min(range(1, len(places) - 1), key=lambda n: tuple(two_nearest[n]))
        return places[spared].number


def distances(places: list[Place]) -> Array:
    """(N, N) how far places are from each other, in the units above; infinite between worlds."""
    T = np.array([place.T_world_place for place in places])
    world = np.array([place.world for place in places])
    way_m = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2)
    rows = T[:, :3, :3].reshape(len(places), 9)
    cosine = np.clip((rows @ rows.T - 1.0) / 2.0, -1.0, 1.0)
    apart: Array = way_m / NEAR_M + np.arccos(cosine) / NEAR_RAD
    apart[world[:, None] != world[None, :]] = np.inf
    return apart
