"""Output of poses and status over Zenoh: what it declares on a session, and its own thread."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import zenoh

from drivers.core.flow_control import BlockingQueue, BoundedQueue, DropOldestQueue, WorkerThread
from vo_service.config_tables import Ros2Config, ZenohConfig
from vo_service.outputs.zenoh.connection import ConnectOnce, ConnectPolicy, unread_bytes
from vo_service.outputs.zenoh.queryables import (
    CDR,
    CDR_TRANSFORM,
    JSON,
    CommandEndpoint,
    LatestMessages,
    NullCommandEndpoint,
    Queryables,
)
from vo_service.types import NO_MAP, MapSnapshot, OdometryUpdate
from vo_service.types.messages import (
    FrameIds,
    Status,
    encode_message,
    map_odom_attachment,
    map_odom_payload,
    pose_attachment,
    pose_payload,
    versions,
)

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.outputs.zenoh.ros2 import Ros2Publisher

logger = logging.getLogger(__name__)

THREAD_JOIN_TIMEOUT_S = 0.5

ZenohItem = OdometryUpdate | Status


@dataclass(frozen=True)
class QosProfile:
    """Whether a slow subscriber misses messages or slows the publisher down.

    Attributes:
        congestion: What Zenoh does if a link is congested.
        make_queue: Makes the queue of results.
        min_idle_checks: Successive checks without unread data before the session closes.
        drain_timeout_s: Longest wait for subscribers to read, at the end.
        close_timeout_s: Longest wait for the worker thread, at the end.
    """

    congestion: zenoh.CongestionControl
    make_queue: Callable[[], BoundedQueue[ZenohItem]]
    min_idle_checks: int
    drain_timeout_s: float
    close_timeout_s: float


# A robot cannot wait for a slow subscriber: the newest pose matters.
LIVE_QOS = QosProfile(
    zenoh.CongestionControl.DROP,
    lambda: DropOldestQueue(4),
    0,
    drain_timeout_s=0.0,
    close_timeout_s=2.0,
)
# A replay can wait: every pose arrives, in order.
LOCKSTEP_QOS = QosProfile(
    zenoh.CongestionControl.BLOCK,
    lambda: BlockingQueue(16),
    2,
    drain_timeout_s=10.0,
    close_timeout_s=25.0,
)


@dataclass(frozen=True)
class ExtraEndpoints:
    """Optional endpoints on the session.

    Attributes:
        commands: Receives commands.
        ros2: Topics for ROS 2.
        on_session: Called with each new session, to declare more on it.
        on_pose: Called with each update once its pose is sent, on the thread that sends poses.
    """

    commands: CommandEndpoint = field(default_factory=NullCommandEndpoint)
    ros2: Ros2Config = Ros2Config()  # noqa: RUF009 (frozen)
    on_session: Callable[[zenoh.Session], None] = lambda _: None
    on_pose: Callable[[OdometryUpdate], None] = lambda _: None


@dataclass(frozen=True)
class EndpointConfig:
    """Configuration of the endpoints on one session."""

    prefix: str
    frame_ids: FrameIds
    congestion: zenoh.CongestionControl
    queryables: Queryables
    extra: ExtraEndpoints


class SessionEndpoints:
    """Publishers, queryables, commands and the liveliness token `alive` of one session.

    The token is declared last: a client that sees it finds everything else.

    Raises:
        InputError: The ROS 2 topic is invalid.
    """

    def __init__(self, session: zenoh.Session, config: EndpointConfig) -> None:
        self.session = session
        prefix = config.prefix
        self._odom = session.declare_publisher(
            f"{prefix}/odom",
            encoding=CDR,
            congestion_control=config.congestion,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._map_odom = session.declare_publisher(
            f"{prefix}/map_odom",
            encoding=CDR_TRANSFORM,
            congestion_control=config.congestion,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._status = session.declare_publisher(
            f"{prefix}/status", encoding=JSON, congestion_control=config.congestion
        )
        self._ros2 = _open_ros2(session, config)
        self._threads = config.queryables.declare(session)
        self._threads += config.extra.commands.declare(session, prefix)
        config.extra.on_session(session)
        self._alive = session.liveliness().declare_token(f"{prefix}/alive")

    def publish_pose(self, update: OdometryUpdate, payload: bytes, attachment: bytes) -> None:
        """Publish one pose; `payload` is its CDR."""
        self._odom.put(payload, attachment=attachment)
        if self._ros2 is not None:
            self._ros2.publish(update, payload)

    def publish_map_odom(self, payload: bytes, attachment: bytes) -> None:
        """Publish the map->odom transform."""
        self._map_odom.put(payload, attachment=attachment)

    def publish_status(self, payload: bytes) -> None:
        """Publish a status."""
        self._status.put(payload)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until there is a subscriber to the poses; return False on timeout."""
        is_matched = threading.Event()

        def on_change(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                is_matched.set()

        listener = self._odom.declare_matching_listener(on_change)
        try:
            return _has_subscriber(self._odom) or is_matched.wait(timeout_s)
        finally:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Withdraw the token and close the session."""
        parts: list[Callable[[], object]] = [self._alive.undeclare, self.session.close]
        if self._ros2 is not None:
            parts.insert(1, self._ros2.close)
        for close in parts:
            with suppress(zenoh.ZError):  # a broken link
                close()
        # A thread that is still inside Zenoh when Python exits crashes the process.
        for thread in self._threads:
            thread.join(THREAD_JOIN_TIMEOUT_S)


def _open_ros2(session: zenoh.Session, config: EndpointConfig) -> "Ros2Publisher | None":
    """Publish for ROS 2 if it is enabled."""
    settings = config.extra.ros2
    if not settings.enabled:
        return None
    from vo_service.outputs.zenoh.ros2 import Ros2Publisher

    return Ros2Publisher(session, settings, config.prefix, config.frame_ids, config.congestion)


def _has_subscriber(publisher: zenoh.Publisher) -> bool:
    # Zenoh's stub declares bool, but the value is an object that is always true.
    status: zenoh.MatchingStatus = publisher.matching_status  # type: ignore[assignment]
    return status.matching


class ZenohOutput:
    """Publishes poses, the map->odom transform and the status; replies to queries.

    Keys under `{prefix}`; `docs/reference/messages.md` has the details:

    - odom: CDR ``nav_msgs/msg/Odometry``; attachment: JSON of schema, seq, state, epoch, reason
    - map_odom: map->odom transform, if there is a map: on each change, at each new epoch and with
      each status. CDR ``geometry_msgs/msg/TransformStamped``; attachment: JSON of schema, seq,
      epoch, is_localized, map_keyframes, loop_closures
    - status: JSON of schema, every field of `Status`, versions
    - alive: liveliness token of this object
    - latest, map_odom, status, schema, command/NAME: queryables

    A pose with a number that is not finite is never published; the error is logged and counted.

    Args:
        config: Prefix, frames and endpoints.
        qos: How to treat slow subscribers.
        connect_policy: Opens the session; its errors are raised.
        extra_endpoints: Commands, ROS 2 and others; None is none of them.
    """

    def __init__(
        self,
        config: ZenohConfig,
        qos: QosProfile = LIVE_QOS,
        connect_policy: ConnectPolicy = ConnectOnce,
        extra_endpoints: ExtraEndpoints | None = None,
    ) -> None:
        self._extra = extra_endpoints or ExtraEndpoints()
        self._qos = qos
        self._versions = versions()
        self._latest = LatestMessages()
        self._endpoint_config = EndpointConfig(
            prefix=config.prefix,
            frame_ids=FrameIds(config.odom_frame_id, config.child_frame_id, config.map_frame_id),
            congestion=qos.congestion,
            queryables=Queryables(config.prefix, self._latest),
            extra=self._extra,
        )
        # The map that was last published, and its epoch.
        self._published_map: tuple[MapSnapshot, int] = (NO_MAP, 0)
        self._error = ""
        self._connection = connect_policy(config)
        self._endpoints: list[SessionEndpoints] = []
        self._sync_endpoints()
        self._worker: WorkerThread[ZenohItem] = WorkerThread(
            "zenoh", qos.make_queue(), self._publish, self._finish
        )

    @property
    def warning(self) -> str:
        """The fault of the session, or of the last message; "" if there is none."""
        return self._connection.warning or self._error

    @property
    def description(self) -> str:
        """The prefix, the endpoints and how to listen to them, for people."""
        return f"{self._endpoint_config.prefix}/odom at {self._connection.description}"

    @property
    def dropped(self) -> int:
        """Number of results dropped from the queue."""
        return self._worker.dropped

    @property
    def errors(self) -> int:
        """Number of results that could not be published."""
        return self._worker.errors

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue one pose."""
        self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put(status)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until there is a subscriber to the poses; return False on timeout."""
        return any(endpoints.wait_for_subscriber(timeout_s) for endpoints in self._endpoints)

    def close(self) -> None:
        """Publish what is queued, let subscribers read it, and close the session."""
        self._worker.close(self._qos.close_timeout_s)

    def _publish(self, item: ZenohItem) -> None:
        try:
            self._publish_status(item) if isinstance(item, Status) else self._publish_pose(item)
        except (ValueError, zenoh.ZError) as error:
            self._error = f"zenoh: a message could not be published: {error}"
            raise
        self._error = ""

    def _publish_pose(self, update: OdometryUpdate) -> None:
        payload = pose_payload(update, self._endpoint_config.frame_ids)
        attachment = pose_attachment(update)
        self._latest.pose = (payload, attachment)
        for endpoints in self._endpoints:
            endpoints.publish_pose(update, payload, attachment)
        if update.map is not NO_MAP:
            self._publish_map(update)
        self._extra.on_pose(update)

    def _publish_map(self, update: OdometryUpdate) -> None:
        """Store the transform with the newest stamp; publish it if the map or epoch changed."""
        payload = map_odom_payload(update, self._endpoint_config.frame_ids)
        self._latest.map_odom = (payload, map_odom_attachment(update))
        current = (update.map, update.epoch)
        if current != self._published_map:
            self._published_map = current
            self._send_map()

    def _send_map(self) -> None:
        if self._latest.map_odom is not None:
            for endpoints in self._endpoints:
                endpoints.publish_map_odom(*self._latest.map_odom)

    def _publish_status(self, status: Status) -> None:
        payload = encode_message(status, {"versions": self._versions})
        self._latest.status = payload
        self._sync_endpoints()
        for endpoints in self._endpoints:
            endpoints.publish_status(payload)
        self._send_map()  # for new subscribers

    def _sync_endpoints(self) -> None:
        """Declare the endpoints on the open session, if they are not declared there yet."""
        sessions = self._connection.sessions()
        current = [endpoints for endpoints in self._endpoints if endpoints.session in sessions]
        if len(current) < len(sessions):
            current = [SessionEndpoints(session, self._endpoint_config) for session in sessions]
        self._endpoints = current

    def _finish(self) -> None:
        self._extra.commands.close()
        for endpoints in self._endpoints:
            if not self._drain(endpoints):
                logger.warning("zenoh: a subscriber does not read; its last poses are lost")
            endpoints.close()

    def _drain(self, endpoints: SessionEndpoints) -> bool:
        """Wait until subscribers have read everything; return False on timeout.

        Closing first would lose data: a subscriber that still reads sends a keep-alive, the closed
        socket resets the connection, and the kernel discards undelivered data.
        """
        deadline_s = time.monotonic() + self._qos.drain_timeout_s
        idle_checks = 0
        while idle_checks < self._qos.min_idle_checks:
            if time.monotonic() > deadline_s:
                return False
            idle_checks = 0 if unread_bytes(endpoints.session) else idle_checks + 1
            time.sleep(0.01)
        return True
