"""Whether the newest pose can be used, and if not, why: worked out from all that was heard."""

from vo_service.client.errors import NoPose, Why
from vo_service.client.hearing import Hearing
from vo_service.client.pose import LOST, Heard, make_pose

# The status comes twice a second; without one for so long, nothing gets through.
SILENCE_S = 2.0


def usable(hearing: Hearing, max_age_s: float, where: str) -> Heard:
    """The newest pose, if it is no older than that and not lost.

    Raises NoPose with the reason.
    """
    heard = hearing.pose.item
    if heard is None or not hearing.pose.age_s <= max_age_s:
        raise _no_pose(hearing, *_why_none(hearing, where))
    if heard.about["state"] == LOST:
        raise _no_pose(hearing, Why.LOST, f"tracking is lost: {heard.about['reason']}")
    return heard


def why_none(hearing: Hearing, where: str) -> NoPose:
    """Why no pose comes."""
    return _no_pose(hearing, *_why_none(hearing, where))


def _no_pose(hearing: Hearing, why: Why, message: str) -> NoPose:
    heard = hearing.pose.item
    last = None if heard is None else make_pose(heard, is_continuous=False, missed=0)
    return NoPose(why, message, last)


def _why_none(hearing: Hearing, where: str) -> tuple[Why, str]:
    status = hearing.status.item
    if hearing.unreadable:
        return Why.UNREADABLE, hearing.unreadable
    if not hearing.is_alive:
        return Why.NO_PUBLISHER, f"no kinect-vo publishes {where}"
    if status is None or hearing.status.age_s > SILENCE_S:
        return Why.SILENT, "the service is there, but nothing comes of it"
    if status["paused"]:
        return Why.PAUSED, "the service is paused"
    if status["state"] == "no_camera":
        return Why.NO_CAMERA, f"no camera: {status['reason']}"
    if status["state"] == LOST:
        return Why.LOST, f"tracking is lost: {status['reason']}"
    since = "yet" if hearing.pose.item is None else f"for {hearing.pose.age_s:.1f} s"
    return Why.SILENT, f"no pose {since}, though the service says {status['state']}"
