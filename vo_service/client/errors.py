"""Why there is no pose, and why a command was not carried out."""

from enum import StrEnum

from vo_service.client.pose import Pose


class PoseUnavailableReason(StrEnum):
    """Why there is no pose that can be used."""

    NO_PUBLISHER = "no-publisher"  # no kinect-vo with this prefix is there
    NO_CAMERA = "no-camera"
    LOST = "lost"  # the poses that come are the last good one, repeated
    PAUSED = "paused"
    SILENT = "silent"  # it is there, but nothing comes: stuck, or the network is
    UNREADABLE = "unreadable"  # another version of the messages


class PoseUnavailable(Exception):  # noqa: N818 (an answer, where nothing need be wrong)
    """There is no pose that can be used; the text says why, `why` says it to programs.

    last    the last pose that came, however old; None before the first
    """

    def __init__(self, reason: PoseUnavailableReason, message: str, last: Pose | None) -> None:
        super().__init__(message)
        self.reason = reason
        self.last = last


class CommandRefused(Exception):  # noqa: N818 (named after what happened)
    """The service refused a command, or could not carry it out; the text is what it said.

    code    bad-request, unknown-command, not-possible, busy, rate-limited, failed or timed-out
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class ServiceUnavailable(Exception):  # noqa: N818
    """Nobody answered: no service is there, its commands are off, or it may not answer us.

    Also what a client says to every question once it is closed.
    """
