"""Selection of a recording's frames for a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class FrameSelection:
    """Every n-th of the frames (`step`), up to the first `max_frames`."""

    step: int = 1
    max_frames: int | None = None

    def select(self, frames: Sequence[T]) -> list[T]:
        """Return the selected frames."""
        return list(frames[: self.max_frames : self.step])

    @property
    def suffix(self) -> str:
        """Suffix for the recording's name; "" for all frames."""
        first = "" if self.max_frames is None else f"-first-{self.max_frames}"
        return first + (f"-every-{self.step}" if self.step > 1 else "")


ALL_FRAMES = FrameSelection()
