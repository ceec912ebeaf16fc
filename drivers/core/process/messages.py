"""What every process in the background is told or says, whatever else it does."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Shutdown:
    """To the process, last: the service ends in order."""


@dataclass(frozen=True)
class Heartbeat:
    """From the process, every second: it takes orders. What it says beside is up to it."""


@dataclass(frozen=True)
class LogMessage:
    """From the driver, for the service's log."""

    level: int
    logger_name: str
    text: str
