"""The places of a map, and which of them look like a view."""

from collections.abc import Callable, Iterator

import numpy as np

from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.query_frame import QueryFrame


class KeyframeDatabase:
    """Places by their numbers, which rise."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._keyframes: dict[int, MapKeyframe] = {}
        self._size_bytes = 0

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[MapKeyframe]:
        return iter(self._keyframes.values())

    def __getitem__(self, number: int) -> MapKeyframe:
        return self._keyframes[number]

    def __contains__(self, number: int) -> bool:
        return number in self._keyframes

    @property
    def size_bytes(self) -> int:
        """What all of them take."""
        return self._size_bytes

    @property
    def is_over_capacity(self) -> bool:
        """Whether they take more than they may."""
        return self._size_bytes > self._max_bytes

    def add(self, keyframe: MapKeyframe) -> None:
        """Add one, of a higher number than any before."""
        if self._keyframes and keyframe.number <= next(reversed(self._keyframes)):
            raise ValueError(f"place {keyframe.number} is no newer than the others")
        self._keyframes[keyframe.number] = keyframe
        self._size_bytes += keyframe.size_bytes

    def remove(self, number: int) -> None:
        """Forget one. Raises KeyError if there is none of this number."""
        self._size_bytes -= self._keyframes.pop(number).size_bytes

    def find_similar(
        self, query: QueryFrame, count: int, is_allowed: Callable[[MapKeyframe], bool]
    ) -> list[MapKeyframe]:
        """The places among those allowed that look most like a view, the most alike first."""
        places = [place for place in self if is_allowed(place)]
        if not places:
            return []
        summaries = np.stack([place.vlad_descriptor for place in places]).astype(np.float32)
        likeness = summaries @ query.vlad_descriptor.astype(np.float32)
        best = np.argsort(-likeness, kind="stable")[:count]
        return [places[n] for n in best]
