"""Errors of the client: no pose, a refused command, no service."""

from enum import StrEnum

from vo_service.client.pose import Pose


class PoseUnavailableReason(StrEnum):
    """Reason why there is no usable pose."""

    NO_PUBLISHER = "no-publisher"  # no kinect-vo with this prefix is reachable
    NO_CAMERA = "no-camera"
    LOST = "lost"  # the service repeats the last good pose
    PAUSED = "paused"
    SILENT = "silent"  # the service is up but publishes nothing: it hangs, or the network does
    UNREADABLE = "unreadable"  # another version of the messages


class PoseUnavailable(Exception):  # noqa: N818 (not necessarily an error)
    """There is no usable pose; the text says why.

    Attributes:
        reason: The same for programs.
        last: Last pose received, however old; None before the first.
    """

    def __init__(self, reason: PoseUnavailableReason, message: str, last: Pose | None) -> None:
        super().__init__(message)
        self.reason = reason
        self.last = last


class CommandRefused(Exception):  # noqa: N818 (named after what happened)
    """The service refused or failed a command; the text is the service's message.

    Attributes:
        code: bad-request, unknown-command, not-possible, busy, rate-limited, failed or timed-out.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class ServiceUnavailable(Exception):  # noqa: N818
    """No reply: no service is reachable, its commands are off, or access is denied.

    A closed client raises it for every query.
    """


class FrameUnavailable(Exception):  # noqa: N818
    """No image or points arrived in time; the text says why."""
