"""What must hold of everything a subscriber has received, whatever went wrong with the service."""

from collections.abc import Sequence
from itertools import pairwise

from tests.vo_service.subscriber import (
    RecordingSubscriber,
    StatusContent,
    SubscribedPose,
    SubscribedStatus,
)

# So many statuses in a row that say all is well, and not one more frame: a silent stop.
MAX_SILENT_STATUSES = 4


def check_received(received: RecordingSubscriber, log: str = "") -> None:
    """No number that is none, no order turned round, no silence without a reason, no traceback.

    `received` is of one life of one service, `log` all that it has said.
    """
    assert not received.unreadable
    check_ordering(received.poses)
    check_not_silent(received.statuses)
    assert "Traceback" not in log, log


def check_ordering(poses: Sequence[SubscribedPose]) -> None:
    """Finite; numbers rise; stamps rise, but for a new epoch that says why they do not."""
    assert all(pose.is_finite for pose in poses)
    for before, after in pairwise(poses):
        assert after.seq > before.seq
        assert after.epoch >= before.epoch
        went_back = after.stamp_s <= before.stamp_s
        assert not went_back or (after.epoch > before.epoch and after.reason == "clock_step")


def check_not_silent(statuses: Sequence[SubscribedStatus]) -> None:
    """Who says that all is well goes on."""
    silent = 0
    for before, after in pairwise(statuses):
        counts = [
            status.content["tracking"]["frames"] + status.content["camera"]["skipped"]
            for status in (before, after)
        ]
        is_well = after.content["state"] == "tracking" and not after.content["reason"]
        silent = silent + 1 if is_well and counts[0] == counts[1] else 0
        assert silent < MAX_SILENT_STATUSES, f"a silent stop: {after.content}"


def _count_frames(status: StatusContent) -> int:
    return int(status["tracking"]["frames"] + status["camera"]["skipped"])
