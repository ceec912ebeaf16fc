"""Messages that every background process sends or receives."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Shutdown:
    """To the process, as the last message: the service ends in order."""


@dataclass(frozen=True)
class Heartbeat:
    """From the process, every second: it is alive and receives messages."""


@dataclass(frozen=True)
class LogMessage:
    """From the worker, for the log of the service."""

    level: int
    logger_name: str
    text: str
