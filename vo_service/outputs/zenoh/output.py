"""Poses and status over Zenoh, published from a thread of its own."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh

from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue, WorkerThread
from vo_service.config_tables import Ros2Config, ZenohConfig
from vo_service.outputs.zenoh.command_server import CommandEndpoint, NullCommandEndpoint
from vo_service.outputs.zenoh.connection import ConnectOnce, ConnectPolicy
from vo_service.outputs.zenoh.messages import (
    FrameIds,
    map_odom_attachment,
    map_odom_payload,
    pose_attachment,
    pose_payload,
    status_payload,
)
from vo_service.outputs.zenoh.queryables import LatestMessages, Queryables
from vo_service.outputs.zenoh.session_endpoints import EndpointConfig, SessionEndpoints
from vo_service.types import NO_MAP, MapSnapshot, OdometryUpdate, Status
from vo_service.versions import versions

logger = logging.getLogger(__name__)

ZenohItem = OdometryUpdate | Status


@dataclass(frozen=True)
class QosProfile:
    """What a subscriber that cannot keep up means: a gap for it, or a wait for us."""

    congestion: zenoh.CongestionControl
    make_queue: Callable[[], BoundedQueue[ZenohItem]]
    min_idle_checks: int  # how often in a row nothing may be under way before the session closes
    drain_timeout_s: float
    close_timeout_s: float


# A robot cannot wait for a slow reader: the newest pose wins.
LIVE_QOS = QosProfile(
    zenoh.CongestionControl.DROP,
    lambda: DropOldestQueue(4),
    0,
    drain_timeout_s=0.0,
    close_timeout_s=2.0,
)
# A replay can: every pose arrives, in order, the last one too.
LOCKSTEP_QOS = QosProfile(
    zenoh.CongestionControl.BLOCK,
    lambda: BlockingQueue(16),
    2,
    drain_timeout_s=10.0,
    close_timeout_s=25.0,
)


@dataclass(frozen=True)
class ExtraEndpoints:
    """What else is offered on the session."""

    commands: CommandEndpoint = field(default_factory=NullCommandEndpoint)
    ros2: Ros2Config = Ros2Config()  # noqa: RUF009 (frozen)


class ZenohOutput:
    """Publishes each pose on `{prefix}/odom` and the status on `{prefix}/status`.

    odom     CDR ``nav_msgs/msg/Odometry``; attachment: JSON of schema, seq, state, epoch, reason
    map_odom how `odom` lies in the map, where there is one: when that or the epoch has changed, and
             with each status. CDR ``geometry_msgs/msg/TransformStamped``; attachment: JSON of
             schema, seq, epoch, is_localized, places, loops
    status   JSON: schema, every field of `Status`, versions
    alive    a liveliness token that lasts as long as this object (or its process)
    latest, map_odom, status, schema, command/NAME   answer questions; see `docs/messages.md`

    A pose with a number that is not finite is never published: the error is logged and counted.
    Raises what `connect_policy` raises where the session cannot be opened.
    """

    def __init__(
        self,
        config: ZenohConfig,
        qos: QosProfile = LIVE_QOS,
        connect_policy: ConnectPolicy = ConnectOnce,
        extra_endpoints: ExtraEndpoints | None = None,
    ) -> None:
        extra_endpoints = extra_endpoints or ExtraEndpoints()
        self._qos = qos
        self._versions = versions()
        self._latest = LatestMessages()
        self._commands = extra_endpoints.commands
        self._endpoint_config = EndpointConfig(
            prefix=config.prefix,
            frame_ids=FrameIds(config.odom_frame_id, config.child_frame_id, config.map_frame_id),
            congestion=qos.congestion,
            queryables=Queryables(config.prefix, self._latest),
            commands=extra_endpoints.commands,
            ros2=extra_endpoints.ros2,
        )
        self._published_map: tuple[MapSnapshot, int] = (
            NO_MAP,
            0,
        )  # what was published, of which epoch
        self._error = ""
        self._connection = connect_policy(config)
        self._endpoints: list[SessionEndpoints] = []
        self._sync_endpoints()
        self._worker: WorkerThread[ZenohItem] = WorkerThread(
            "zenoh", qos.make_queue(), self._publish, self._finish
        )

    @property
    def warning(self) -> str:
        """What is wrong with the session, or with the last message."""
        return self._connection.warning or self._error

    @property
    def description(self) -> str:
        """The prefix and the endpoints, and how to listen there: for a person."""
        return f"{self._endpoint_config.prefix}/odom at {self._connection.description}"

    @property
    def dropped(self) -> int:
        """Results that newer ones replaced before they were published."""
        return self._worker.dropped

    @property
    def errors(self) -> int:
        """Results that could not be published."""
        return self._worker.errors

    def on_update(self, update: OdometryUpdate) -> None:
        """Publish one pose (soon)."""
        self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Publish the status (soon)."""
        self._worker.put(status)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until someone subscribes to the poses. False if nobody does in time."""
        return any(station.wait_for_subscriber(timeout_s) for station in self._endpoints)

    def close(self) -> None:
        """Publish what was taken, let subscribers read it, and leave."""
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
        for station in self._endpoints:
            station.publish_pose(update, payload, attachment)
        if update.map is not NO_MAP:
            self._publish_map(update)

    def _publish_map(self, update: OdometryUpdate) -> None:
        """Remember it with the newest stamp; publish it if it is another."""
        payload = map_odom_payload(update, self._endpoint_config.frame_ids)
        self._latest.map_odom = (payload, map_odom_attachment(update))
        mapped = (update.map, update.epoch)
        if mapped != self._published_map:
            self._published_map = mapped
            self._send_map()

    def _send_map(self) -> None:
        if self._latest.map_odom is not None:
            for station in self._endpoints:
                station.publish_map_odom(*self._latest.map_odom)

    def _publish_status(self, status: Status) -> None:
        payload = status_payload(status, self._versions)
        self._latest.status = payload
        self._sync_endpoints()
        for station in self._endpoints:
            station.publish_status(payload)
        self._send_map()  # for those who came late

    def _sync_endpoints(self) -> None:
        """See that there is a station on the session that is open now, if one is."""
        sessions = self._connection.sessions()
        kept = [station for station in self._endpoints if station.session in sessions]
        if len(kept) < len(sessions):
            kept = [SessionEndpoints(session, self._endpoint_config) for session in sessions]
        self._endpoints = kept

    def _finish(self) -> None:
        self._commands.close()
        for station in self._endpoints:
            if not self._drain(station):
                logger.warning("zenoh: a subscriber does not read; its last poses are lost")
            station.close()

    def _drain(self, station: SessionEndpoints) -> bool:
        """Wait until everything sent has been read. False if that takes too long.

        Closing first would lose it: a subscriber that is still reading answers with a keep-alive,
        the closed socket refuses it, and the kernel throws away what it had not delivered.
        """
        deadline_s = time.monotonic() + self._qos.drain_timeout_s
        quiet = 0
        while quiet < self._qos.min_idle_checks:
            if time.monotonic() > deadline_s:
                return False
            quiet = 0 if station.queued_bytes() else quiet + 1
            time.sleep(0.01)
        return True
