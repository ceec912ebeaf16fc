"""Whether the newest pose can be used, and if not, why: worked out from all that was heard."""

from vo_service.client.errors import PoseUnavailable, PoseUnavailableReason
from vo_service.client.pose import LOST, ReceivedPose, make_pose
from vo_service.client.subscription import ServiceState

# The status comes twice a second; without one for so long, nothing gets through.
MAX_SILENCE_S = 2.0


def require_fresh(state: ServiceState, max_age_s: float, where: str) -> ReceivedPose:
    """The newest pose, if it is no older than that and not lost.

    Raises NoPose with the reason.
    """
    heard = state.pose.item
    if heard is None or not state.pose.age_s <= max_age_s:
        raise _make_error(state, *_unavailable_reason(state, where))
    if heard.attachment["state"] == LOST:
        raise _make_error(
            state, PoseUnavailableReason.LOST, f"tracking is lost: {heard.attachment['reason']}"
        )
    return heard


def pose_unavailable_error(state: ServiceState, where: str) -> PoseUnavailable:
    """Why no pose comes."""
    return _make_error(state, *_unavailable_reason(state, where))


def _make_error(
    state: ServiceState, reason: PoseUnavailableReason, message: str
) -> PoseUnavailable:
    heard = state.pose.item
    last = None if heard is None else make_pose(heard, is_continuous=False, missed=0)
    return PoseUnavailable(reason, message, last)


def _unavailable_reason(state: ServiceState, where: str) -> tuple[PoseUnavailableReason, str]:
    status = state.status.item
    if state.parse_error:
        return PoseUnavailableReason.UNREADABLE, state.parse_error
    if not state.is_alive:
        return PoseUnavailableReason.NO_PUBLISHER, f"no kinect-vo publishes {where}"
    if status is None or state.status.age_s > MAX_SILENCE_S:
        return PoseUnavailableReason.SILENT, "the service is there, but nothing comes of it"
    if status["paused"]:
        return PoseUnavailableReason.PAUSED, "the service is paused"
    if status["state"] == "no_camera":
        return PoseUnavailableReason.NO_CAMERA, f"no camera: {status['reason']}"
    if status["state"] == LOST:
        return PoseUnavailableReason.LOST, f"tracking is lost: {status['reason']}"
    since = "yet" if state.pose.item is None else f"for {state.pose.age_s:.1f} s"
    return (
        PoseUnavailableReason.SILENT,
        f"no pose {since}, though the service says {status['state']}",
    )
