"""What a client hears of one service: the newest of everything, for any number of readers."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import zenoh

from vo_service.client.map_odom import MapOdom, parse_map_odom
from vo_service.client.message_parsing import JsonObject, parse_status
from vo_service.client.pose import ReceivedPose, parse_pose_sample

logger = logging.getLogger(__name__)

StatusMessage = JsonObject
T = TypeVar("T")


class Latest(Generic[T]):
    """The newest of a kind, and how many there were. Guarded by the condition of `ServiceState`.

    unreadable    what was wrong with the last message of this kind; "" if it could be read
    """

    def __init__(self) -> None:
        self.item: T | None = None
        self.count = 0
        self.receive_time_s = float("-inf")
        self.parse_error = ""

    def put(self, item: T) -> None:
        """A newer one."""
        self.item, self.receive_time_s, self.parse_error = item, time.monotonic(), ""
        self.count += 1

    @property
    def age_s(self) -> float:
        """Seconds since it came; infinite before the first."""
        return time.monotonic() - self.receive_time_s


class ServiceState:
    """Keeps the last pose, its place in the map, the last status and whether the service is there.

    Zenoh's threads write, readers read and wait.
    """

    def __init__(self) -> None:
        self.pose: Latest[ReceivedPose] = Latest()
        self.map_odom: Latest[MapOdom] = Latest()
        self.status: Latest[StatusMessage] = Latest()
        self.is_alive = False
        self.is_closed = False
        self._run = 0  # how often the service was started
        self._changed = threading.Condition()

    @property
    def parse_error(self) -> str:
        """What is wrong with the last pose, or else the last status; "" if nothing is."""
        return self.pose.parse_error or self.status.parse_error

    def subscribe(self, session: zenoh.Session, prefix: str) -> None:
        """Begin to listen. The token first: what comes after it is of its run."""
        alive = f"{prefix}/alive"
        session.liveliness().declare_subscriber(alive, self._on_liveliness, history=True)
        session.declare_subscriber(f"{prefix}/status", self._on_status)
        session.declare_subscriber(f"{prefix}/map_odom", self._on_map_odom)
        session.declare_subscriber(f"{prefix}/odom", self._on_pose)

    def wait_until_alive(self, timeout_s: float | None) -> bool:
        """Until the service is there, or `close`; False if it is not in time."""
        with self._changed:
            self._changed.wait_for(lambda: self.is_closed or self.is_alive, timeout_s)
            return self.is_alive

    def wait_for_newer(
        self, latest: Latest[T], count: int, timeout_s: float | None
    ) -> tuple[int, T] | None:
        """The newest once there are more than `count`; None if none comes in time, or `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self.is_closed or latest.count > count, timeout_s)
            if latest.item is None or latest.count <= count:
                return None
            return latest.count, latest.item

    def close(self) -> None:
        """Let go of all who wait."""
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.is_alive = sample.kind == zenoh.SampleKind.PUT
            self._run += self.is_alive
            if not self.is_alive:
                self.map_odom = Latest()  # an epoch's number says nothing about another run
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
        """Keep what is wrong with a message that cannot be read; log it when it is new."""
        try:
            yield
        except ValueError as error:
            if str(error) != latest.parse_error:
                logger.warning("passed over %s", error)
            latest.parse_error = str(error)
        self._changed.notify_all()
