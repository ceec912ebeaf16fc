"""Poses and status over Zenoh, published from a thread of its own."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh

from vo_service.outputs.worker import DropOldest, HandOver, Wait, Worker
from vo_service.outputs.zenoh_commands import Commands, NoCommands
from vo_service.outputs.zenoh_messages import (
    Frames,
    map_odom_attachment,
    map_odom_payload,
    pose_attachment,
    pose_payload,
    status_payload,
)
from vo_service.outputs.zenoh_opening import OpenAtOnce, WayToOpen
from vo_service.outputs.zenoh_questions import Memory, Questions
from vo_service.outputs.zenoh_station import Programme, Station
from vo_service.settings import Ros2Settings, ZenohConfig
from vo_service.types import NO_MAP, MapSnapshot, PoseUpdate, Status
from vo_service.versions import versions

logger = logging.getLogger(__name__)

Item = PoseUpdate | Status


@dataclass(frozen=True)
class Delivery:
    """What a subscriber that cannot keep up means: a gap for it, or a wait for us."""

    congestion: zenoh.CongestionControl
    hand_over: Callable[[], HandOver[Item]]
    quiet_checks: int  # how often in a row nothing may be under way before the session closes
    drain_s: float
    close_s: float


# A robot cannot wait for a slow reader: the newest pose wins.
LIVE = Delivery(zenoh.CongestionControl.DROP, lambda: DropOldest(4), 0, drain_s=0.0, close_s=2.0)
# A replay can: every pose arrives, in order, the last one too.
LOCKSTEP = Delivery(zenoh.CongestionControl.BLOCK, lambda: Wait(16), 2, drain_s=10.0, close_s=25.0)


@dataclass(frozen=True)
class Extras:
    """What else is offered on the session."""

    commands: Commands = field(default_factory=NoCommands)
    ros2: Ros2Settings = Ros2Settings()  # noqa: RUF009 (frozen)


class ZenohOutput:
    """Publishes each pose on `{prefix}/odom` and the status on `{prefix}/status`.

    odom     CDR ``nav_msgs/msg/Odometry``; attachment: JSON of schema, seq, state, epoch, reason
    map_odom how `odom` lies in the map, where there is one: when that or the epoch has changed, and
             with each status. CDR ``geometry_msgs/msg/TransformStamped``; attachment: JSON of
             schema, seq, epoch, is_located, places, loops
    status   JSON: schema, every field of `Status`, versions
    alive    a liveliness token that lasts as long as this object (or its process)
    latest, map_odom, status, schema, command/NAME   answer questions; see `docs/messages.md`

    A pose with a number that is not finite is never published: the error is logged and counted.
    Raises what `way_to_open` raises where the session cannot be opened.
    """

    def __init__(
        self,
        config: ZenohConfig,
        delivery: Delivery = LIVE,
        way_to_open: WayToOpen = OpenAtOnce,
        extras: Extras | None = None,
    ) -> None:
        extras = extras or Extras()
        self._delivery = delivery
        self._versions = versions()
        self._memory = Memory()
        self._commands = extras.commands
        self._programme = Programme(
            prefix=config.prefix,
            frames=Frames(config.odom_frame_id, config.child_frame_id, config.map_frame_id),
            congestion=delivery.congestion,
            questions=Questions(config.prefix, self._memory),
            commands=extras.commands,
            ros2=extras.ros2,
        )
        self._mapped: tuple[MapSnapshot, int] = (NO_MAP, 0)  # what was published, of which epoch
        self._failure = ""
        self._opening = way_to_open(config)
        self._stations: list[Station] = []
        self._settle()
        self._worker: Worker[Item] = Worker(
            "zenoh", delivery.hand_over(), self._publish, self._finish
        )

    @property
    def warning(self) -> str:
        """What is wrong with the session, or with the last message."""
        return self._opening.warning or self._failure

    @property
    def where(self) -> str:
        """The prefix and the endpoints, and how to listen there: for a person."""
        return f"{self._programme.prefix}/odom at {self._opening.where}"

    @property
    def dropped(self) -> int:
        """Results that newer ones replaced before they were published."""
        return self._worker.dropped

    @property
    def errors(self) -> int:
        """Results that could not be published."""
        return self._worker.errors

    def pose(self, update: PoseUpdate) -> None:
        """Publish one pose (soon)."""
        self._worker.put(update)

    def status(self, status: Status) -> None:
        """Publish the status (soon)."""
        self._worker.put(status)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until someone subscribes to the poses. False if nobody does in time."""
        return any(station.wait_for_subscriber(timeout_s) for station in self._stations)

    def close(self) -> None:
        """Publish what was taken, let subscribers read it, and leave."""
        self._worker.close(self._delivery.close_s)

    def _publish(self, item: Item) -> None:
        try:
            self._publish_status(item) if isinstance(item, Status) else self._publish_pose(item)
        except (ValueError, zenoh.ZError) as error:
            self._failure = f"zenoh: a message could not be published: {error}"
            raise
        self._failure = ""

    def _publish_pose(self, update: PoseUpdate) -> None:
        payload = pose_payload(update, self._programme.frames)
        attachment = pose_attachment(update)
        self._memory.pose = (payload, attachment)
        for station in self._stations:
            station.pose(update, payload, attachment)
        if update.map is not NO_MAP:
            self._publish_map(update)

    def _publish_map(self, update: PoseUpdate) -> None:
        """Remember it with the newest stamp; publish it if it is another."""
        payload = map_odom_payload(update, self._programme.frames)
        self._memory.map_odom = (payload, map_odom_attachment(update))
        mapped = (update.map, update.epoch)
        if mapped != self._mapped:
            self._mapped = mapped
            self._send_map()

    def _send_map(self) -> None:
        if self._memory.map_odom is not None:
            for station in self._stations:
                station.map_odom(*self._memory.map_odom)

    def _publish_status(self, status: Status) -> None:
        payload = status_payload(status, self._versions)
        self._memory.status = payload
        self._settle()
        for station in self._stations:
            station.status(payload)
        self._send_map()  # for those who came late

    def _settle(self) -> None:
        """See that there is a station on the session that is open now, if one is."""
        sessions = self._opening.sessions()
        kept = [station for station in self._stations if station.session in sessions]
        if len(kept) < len(sessions):
            kept = [Station(session, self._programme) for session in sessions]
        self._stations = kept

    def _finish(self) -> None:
        self._commands.close()
        for station in self._stations:
            if not self._drained(station):
                logger.warning("zenoh: a subscriber does not read; its last poses are lost")
            station.close()

    def _drained(self, station: Station) -> bool:
        """Wait until everything sent has been read. False if that takes too long.

        Closing first would lose it: a subscriber that is still reading answers with a keep-alive,
        the closed socket refuses it, and the kernel throws away what it had not delivered.
        """
        deadline_s = time.monotonic() + self._delivery.drain_s
        quiet = 0
        while quiet < self._delivery.quiet_checks:
            if time.monotonic() > deadline_s:
                return False
            quiet = 0 if station.backlog_bytes() else quiet + 1
            time.sleep(0.01)
        return True
