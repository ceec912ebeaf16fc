"""The latest messages of one service, for any number of readers."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Self, TypeVar

import zenoh

from vo_service.client.connection import (
    BackgroundConnection,
    PoseUnavailable,
    PoseUnavailableReason,
)
from vo_service.client.pose import (
    LOST,
    MapOdom,
    ReceivedPose,
    make_pose,
    parse_map_odom,
    parse_pose_sample,
)
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig, check_prefix
from vo_service.outputs.zenoh.addresses import check_endpoint
from vo_service.outputs.zenoh.zenoh_config import MAX_MESSAGE_BYTES
from vo_service.types.messages import JsonObject, decode_message, parse_json_message

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class _RequiredStatusFields:
    state: str
    reason: str
    paused: bool


def parse_status(payload: zenoh.ZBytes) -> JsonObject:
    """Parse a status, and check the fields that the client reads.

    Raises:
        ValueError: If it is not valid.
    """
    status = parse_json_message(payload.to_bytes())
    decode_message(_RequiredStatusFields, status, "a status")
    return status


StatusMessage = JsonObject
T = TypeVar("T")


class Latest(Generic[T]):
    """The latest message of one kind. `ServiceState` guards it with its condition.

    Attributes:
        item: The message; None before the first.
        count: Messages received so far.
        receive_time_s: Time of arrival, CLOCK_MONOTONIC.
        parse_error: Why the last message could not be parsed; "" if it could.
    """

    def __init__(self) -> None:
        self.item: T | None = None
        self.count = 0
        self.receive_time_s = float("-inf")
        self.parse_error = ""

    def put(self, item: T) -> None:
        """Store a newer message."""
        self.item, self.receive_time_s, self.parse_error = item, time.monotonic(), ""
        self.count += 1

    @property
    def age_s(self) -> float:
        """Seconds since the message arrived; infinite before the first."""
        return time.monotonic() - self.receive_time_s


class ServiceState:
    """Latest pose, map->odom transform, status and liveliness of one service.

    Zenoh's threads write; readers read and wait.
    """

    def __init__(self) -> None:
        self.pose: Latest[ReceivedPose] = Latest()
        self.map_odom: Latest[MapOdom] = Latest()
        self.status: Latest[StatusMessage] = Latest()
        self.is_alive = False
        self.is_closed = False
        self._run = 0  # how often the service has been started
        self._changed = threading.Condition()

    @property
    def parse_error(self) -> str:
        """Why the last pose, or else the last status, could not be parsed; "" if both could."""
        return self.pose.parse_error or self.status.parse_error

    def subscribe(self, session: zenoh.Session, prefix: str) -> None:
        """Declare the subscribers. Liveliness comes first: later messages belong to its run."""
        alive = f"{prefix}/alive"
        session.liveliness().declare_subscriber(alive, self._on_liveliness, history=True)
        session.declare_subscriber(f"{prefix}/status", self._on_status)
        session.declare_subscriber(f"{prefix}/map_odom", self._on_map_odom)
        session.declare_subscriber(f"{prefix}/odom", self._on_pose)

    def wait_until_alive(self, timeout_s: float | None) -> bool:
        """Wait until the service is alive or `close` is called; False on timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self.is_closed or self.is_alive, timeout_s)
            return self.is_alive

    def wait_for_newer(
        self, latest: Latest[T], count: int, timeout_s: float | None
    ) -> tuple[int, T] | None:
        """Wait for a message after the first `count` ones.

        Args:
            count: Number of messages that the reader has seen.
            timeout_s: Longest wait, s; None: without limit.

        Returns:
            The new count and the newest message; None on timeout or `close`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self.is_closed or latest.count > count, timeout_s)
            if latest.item is None or latest.count <= count:
                return None
            return latest.count, latest.item

    def close(self) -> None:
        """Wake all readers that wait."""
        with self._changed:
            self.is_closed, self.is_alive = True, False
            self._changed.notify_all()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.is_alive = sample.kind == zenoh.SampleKind.PUT and not self.is_closed
            self._run += self.is_alive
            if not self.is_alive:
                self.map_odom = Latest()  # epochs of two runs cannot be compared
            self._changed.notify_all()

    def _on_status(self, sample: zenoh.Sample) -> None:
        with self._changed, self._recording_parse_errors(self.status):
            self.status.put(parse_status(sample.payload))

    def _on_pose(self, sample: zenoh.Sample) -> None:
        with self._changed, self._recording_parse_errors(self.pose):
            self.pose.put(parse_pose_sample(sample, self._run))

    def _on_map_odom(self, sample: zenoh.Sample) -> None:
        with self._changed, self._recording_parse_errors(self.map_odom):
            self.map_odom.put(parse_map_odom(sample))

    @contextmanager
    def _recording_parse_errors(self, latest: Latest[T]) -> Iterator[None]:
        """Store the error of a message that cannot be parsed; log it if it is new."""
        try:
            yield
        except ValueError as error:
            if str(error) != latest.parse_error:
                logger.warning("ignored a message: %s", error)
            latest.parse_error = str(error)
        self._changed.notify_all()


class ServiceClient:
    """A connection to one service, and the latest messages of it; a context manager.

    If the service is not there, the client waits and reconnects.
    """

    # A wait for a service that is not there is announced after this time, once.
    ANNOUNCE_AFTER_S = 2.0
    # Larger messages that come in are discarded.
    max_message_bytes = MAX_MESSAGE_BYTES

    def __init__(
        self,
        prefix: str = "kinect",
        connect: str = DEFAULT_ENDPOINT,
        config_file: Path | str | None = None,
    ) -> None:
        """Connect to a service.

        Args:
            prefix: Prefix of the service's Zenoh keys.
            config_file: Zenoh configuration (JSON5, for TLS); its endpoints replace `connect`.

        Raises:
            InputError: An argument is invalid.
        """
        self._prefix = check_prefix(prefix)
        check_endpoint(connect)
        file = None if config_file is None else Path(config_file)
        self._where = f"as {prefix} " + (
            f"at {connect}" if file is None else f"at the endpoints in {file}, or access is denied"
        )
        self._state = ServiceState()
        self._connection = BackgroundConnection(
            ZenohConfig(prefix, listen=(), connect=(connect,), config_file=file),
            lambda session: self._state.subscribe(session, prefix),
            self.max_message_bytes,
        )
        self._announcement = threading.Timer(self.ANNOUNCE_AFTER_S, self._announce_wait)
        self._announcement.daemon = True
        self._announcement.start()

    def _announce_wait(self) -> None:
        if not self._state.is_alive:
            logger.warning("waiting: no kinect-vo publishes %s", self._where)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; loops over messages end. Safe to call twice."""
        self._announcement.cancel()
        self._state.close()
        self._connection.close()


# A status arrives twice a second. After this long without one, the service counts as silent.
MAX_SILENCE_S = 2.0


def require_fresh(state: ServiceState, max_age_s: float, where: str) -> ReceivedPose:
    """Return the newest pose if it is fresh and not lost.

    Args:
        max_age_s: Greatest age, seconds since the pose arrived.
        where: The service's prefix and endpoint, for the message.

    Raises:
        PoseUnavailable: With the reason.
    """
    received = state.pose.item
    if received is None or not state.pose.age_s <= max_age_s:
        raise pose_unavailable_error(state, where)
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
    if state.is_closed:
        return PoseUnavailableReason.NO_PUBLISHER, "this client is closed; open another"
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
