"""The places of a map, and which of them look like a view."""

from collections.abc import Callable, Iterator

import numpy as np

from vo_service.mapping.places.place import Place
from vo_service.mapping.places.view import PlaceView


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
        """Whether they take more than they may."""
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
