"""Why frames of a run have no pose."""

import re
from collections import Counter


def strip_numbers(text: str) -> str:
    """Remove counts from a reason: a reason with other counts is not a new reason."""
    return re.sub(r"\d+", "", text)


class FailureReasons:
    """Counts the frames of a run, and the reasons of those without a pose."""

    def __init__(self) -> None:
        self._frames = 0
        self._counts: Counter[str] = Counter()
        self._examples: dict[str, str] = {}

    def add(self, has_pose: bool, reason: str) -> None:
        """Add a frame."""
        self._frames += 1
        if not has_pose:
            kind = strip_numbers(reason)
            self._counts[kind] += 1
            self._examples.setdefault(kind, reason)

    @property
    def no_motion_reason(self) -> str:
        """The most frequent reason if no frame has a pose, except the first; "" if one has."""
        failed = self._counts.total()
        if failed == 0 or failed < self._frames - 1:
            return ""
        kind, count = self._counts.most_common(1)[0]
        return (
            f"none of {self._frames} frames could be tracked; the most frequent reason ({count} of "
            f"{self._frames}): {self._examples[kind]}; check the images and the camera file"
        )
