"""A timer that lists the stages which an odometry names, and measures nothing."""

from collections.abc import Iterator
from contextlib import contextmanager


class RecordingStageTimer:
    """Stage timer that only records the names of the stages."""

    def __init__(self) -> None:
        self.names: list[str] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Record the name."""
        self.names.append(name)
        yield
