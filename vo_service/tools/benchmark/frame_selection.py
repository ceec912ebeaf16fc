"""Which frames of a recording a run is given."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class FrameSelection:
    """Every n-th of the frames; of the first so many, where `first` is given."""

    step: int = 1
    max_frames: int | None = None

    def select(self, frames: Sequence[T]) -> list[T]:
        """Those that are used."""
        return list(frames[: self.max_frames : self.step])

    @property
    def suffix(self) -> str:
        """What it adds to the recording's name; "" for the whole of it."""
        first = "" if self.max_frames is None else f"-first-{self.max_frames}"
        return first + (f"-every-{self.step}" if self.step > 1 else "")


ALL_FRAMES = FrameSelection()
