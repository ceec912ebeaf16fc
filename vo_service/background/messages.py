"""What every process in the background is told or says, whatever else it does."""

from dataclasses import dataclass


@dataclass(frozen=True)
class End:
    """To the process, last: the service ends in order."""


@dataclass(frozen=True)
class SignOfLife:
    """From the process, every second: it takes orders. What it says beside is up to it."""
