"""A timer that lists the stages which an odometry names, and measures nothing."""

from collections.abc import Iterator
from contextlib import contextmanager


class RecordingStageTimer:
    """The names of the stages so far, in their order."""

    def __init__(self) -> None:
        self.names: list[str] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Note the name."""
        self.names.append(name)
        yield
