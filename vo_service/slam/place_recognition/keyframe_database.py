"""Database of a map's keyframes, searched by similarity."""

from collections.abc import Callable, Iterator

import numpy as np

from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.query_frame import QueryFrame


class KeyframeDatabase:
    """Keyframes by their ascending numbers.

    Args:
        max_bytes: Capacity.
    """

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
        """Memory of all keyframes."""
        return self._size_bytes

    @property
    def is_over_capacity(self) -> bool:
        """Whether the keyframes take more memory than the capacity."""
        return self._size_bytes > self._max_bytes

    def add(self, keyframe: MapKeyframe) -> None:
        """Add a keyframe with a higher number than all others."""
        if self._keyframes and keyframe.number <= next(reversed(self._keyframes)):
            raise ValueError(f"keyframe {keyframe.number} is not newer than the others")
        self._keyframes[keyframe.number] = keyframe
        self._size_bytes += keyframe.size_bytes

    def remove(self, number: int) -> None:
        """Remove a keyframe.

        Raises:
            KeyError: If there is none with this number.
        """
        self._size_bytes -= self._keyframes.pop(number).size_bytes

    def find_similar(
        self, query: QueryFrame, count: int, is_allowed: Callable[[MapKeyframe], bool]
    ) -> list[MapKeyframe]:
        """Find the allowed keyframes that look most like a view, the most similar first."""
        keyframes = [keyframe for keyframe in self if is_allowed(keyframe)]
        if not keyframes:
            return []
        descriptors = np.stack([keyframe.vlad_descriptor for keyframe in keyframes]).astype(
            np.float32
        )
        similarity = descriptors @ query.vlad_descriptor.astype(np.float32)
        best = np.argsort(-similarity, kind="stable")[:count]
        return [keyframes[n] for n in best]
