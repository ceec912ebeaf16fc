"""Which frames of a recording a run is given."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Excerpt:
    """Every n-th of the frames; of the first so many, where `first` is given."""

    every: int = 1
    first: int | None = None

    def of(self, frames: Sequence[T]) -> list[T]:
        """Those that are used."""
        return list(frames[: self.first : self.every])

    @property
    def suffix(self) -> str:
        """What it adds to the recording's name; "" for the whole of it."""
        first = "" if self.first is None else f"-first-{self.first}"
        return first + (f"-every-{self.every}" if self.every > 1 else "")


WHOLE = Excerpt()
