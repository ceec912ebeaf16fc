"""Poses and status over Zenoh, published from a thread of its own."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import zenoh

from vo_service.outputs.cdr import SCHEMA
from vo_service.outputs.output import PoseUpdate, Status
from vo_service.outputs.tcp_backlog import backlog_bytes
from vo_service.outputs.worker import DropOldest, HandOver, Wait, Worker
from vo_service.outputs.zenoh_messages import (
    Frames,
    pose_attachment,
    pose_payload,
    status_payload,
    versions,
)
from vo_service.outputs.zenoh_session import ZenohConfig, open_session

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


class ZenohOutput:
    """Publishes each pose on `{prefix}/odom` and the status on `{prefix}/status`.

    odom    CDR ``nav_msgs/msg/Odometry``; attachment: JSON of schema, seq, state, epoch, reason
    status  JSON: schema, every field of `Status`, versions
    alive   a liveliness token that lasts as long as this object (or its process)

    A pose with a number that is not finite is never published: the error is logged and counted.
    Raises InputError or UserFacingError where the session cannot be opened.
    """

    warning = ""

    def __init__(self, config: ZenohConfig, delivery: Delivery = LIVE) -> None:
        self._delivery = delivery
        self._versions = versions()
        self._frames = Frames(config.odom_frame_id, config.child_frame_id)
        prefix = config.prefix
        self._session = open_session(config)
        self._odom = self._session.declare_publisher(
            f"{prefix}/odom",
            encoding=zenoh.Encoding.APPLICATION_CDR.with_schema(SCHEMA),
            congestion_control=delivery.congestion,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._status = self._session.declare_publisher(
            f"{prefix}/status",
            encoding=zenoh.Encoding.APPLICATION_JSON,
            congestion_control=delivery.congestion,
        )
        self._alive = self._session.liveliness().declare_token(f"{prefix}/alive")
        self._worker: Worker[Item] = Worker(
            "zenoh", delivery.hand_over(), self._publish, self._finish
        )

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
        arrived = threading.Event()

        def on_change(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                arrived.set()

        listener = self._odom.declare_matching_listener(on_change)
        try:
            return _matching(self._odom) or arrived.wait(timeout_s)
        finally:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Publish what was taken, let subscribers read it, and leave."""
        self._worker.close(self._delivery.close_s)

    def _publish(self, item: Item) -> None:
        if isinstance(item, Status):
            self._status.put(status_payload(item, self._versions))
        else:
            self._odom.put(pose_payload(item, self._frames), attachment=pose_attachment(item))

    def _finish(self) -> None:
        if not self._drained():
            logger.warning("zenoh: a subscriber does not read; its last poses are lost")
        self._alive.undeclare()  # type: ignore[no-untyped-call]
        with suppress(zenoh.ZError):  # a link that no longer answers
            self._session.close()  # type: ignore[no-untyped-call]

    def _drained(self) -> bool:
        """Wait until everything sent has been read. False if that takes too long.

        Closing first would lose it: a subscriber that is still reading answers with a keep-alive,
        the closed socket refuses it, and the kernel throws away what it had not delivered.
        """
        deadline_s = time.monotonic() + self._delivery.drain_s
        quiet = 0
        while quiet < self._delivery.quiet_checks:
            if time.monotonic() > deadline_s:
                return False
            links = self._session.info.links()
            waiting = backlog_bytes((_port(link.src), _port(link.dst)) for link in links)
            quiet = 0 if waiting else quiet + 1
            time.sleep(0.01)
        return True


def _matching(publisher: zenoh.Publisher) -> bool:
    # The stub says bool; it is an object that is always true.
    status: zenoh.MatchingStatus = publisher.matching_status  # type: ignore[assignment]
    return status.matching


def _port(locator: str) -> int:
    """Port of a link's end, such as tcp/127.0.0.1:7450; 0 where it has none."""
    port = locator.rsplit(":", 1)[-1]
    return int(port) if port.isdigit() else 0
