"""Whether the newest pose is usable, and the reason if it is not."""

from vo_service.client.errors import PoseUnavailable, PoseUnavailableReason
from vo_service.client.pose import LOST, ReceivedPose, make_pose
from vo_service.client.subscription import ServiceState

# A status arrives twice a second. After this long without one, the service counts as silent.
MAX_SILENCE_S = 2.0


def require_fresh(state: ServiceState, max_age_s: float, where: str) -> ReceivedPose:
    """Return the newest pose if it is fresh and not lost.

    Args:
        state: Messages received so far.
        max_age_s: Greatest age, seconds since the pose arrived.
        where: The service's prefix and endpoint, for the message.

    Raises:
        PoseUnavailable: With the reason.
    """
    received = state.pose.item
    if received is None or not state.pose.age_s <= max_age_s:
        raise _make_error(state, *_unavailable_reason(state, where))
    if received.attachment.state == LOST:
        raise _make_error(
            state, PoseUnavailableReason.LOST, f"tracking is lost: {received.attachment.reason}"
        )
    return received


def pose_unavailable_error(state: ServiceState, where: str) -> PoseUnavailable:
    """Make the error that says why no pose arrives."""
    return _make_error(state, *_unavailable_reason(state, where))


def _make_error(
    state: ServiceState, reason: PoseUnavailableReason, message: str
) -> PoseUnavailable:
    received = state.pose.item
    last = None if received is None else make_pose(received, is_continuous=False, missed=0)
    return PoseUnavailable(reason, message, last)


def _unavailable_reason(state: ServiceState, where: str) -> tuple[PoseUnavailableReason, str]:
    status = state.status.item
    if state.parse_error:
        return PoseUnavailableReason.UNREADABLE, state.parse_error
    if not state.is_alive:
        return PoseUnavailableReason.NO_PUBLISHER, f"no kinect-vo publishes {where}"
    if status is None or state.status.age_s > MAX_SILENCE_S:
        return PoseUnavailableReason.SILENT, "the service is up but publishes nothing"
    if status["paused"]:
        return PoseUnavailableReason.PAUSED, "the service is paused"
    if status["state"] == "no_camera":
        return PoseUnavailableReason.NO_CAMERA, f"no camera: {status['reason']}"
    if status["state"] == LOST:
        return PoseUnavailableReason.LOST, f"tracking is lost: {status['reason']}"
    since = "yet" if state.pose.item is None else f"for {state.pose.age_s:.1f} s"
    return (
        PoseUnavailableReason.SILENT,
        f"no pose {since}, but the service reports {status['state']}",
    )
