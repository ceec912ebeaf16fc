"""Why a command was not carried out."""

from enum import StrEnum


class ErrorCode(StrEnum):
    """What went wrong, for programs; the message says it to people."""

    BAD_REQUEST = "bad-request"  # the arguments are wrong; the same again will not help
    UNKNOWN_COMMAND = "unknown-command"
    NOT_POSSIBLE = "not-possible"  # not with this camera or this configuration, or not now
    BUSY = "busy"  # too many commands are waiting
    RATE_LIMITED = "rate-limited"
    FAILED = "failed"
    TIMED_OUT = "timed-out"


class CommandError(Exception):
    """A command that was refused or failed; the text is one clause that a person understands."""

    def __init__(self, code: ErrorCode, message: str) -> None:
        super().__init__(message)
        self.code = code
