"""What a client hears of one service: the newest of everything, for any number of readers."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import zenoh

from vo_service.client.map_odom import MapOdom, read_map_odom
from vo_service.client.pose import Heard, read_sample
from vo_service.client.reading import Message, read_status

logger = logging.getLogger(__name__)

Status = Message
T = TypeVar("T")


class Newest(Generic[T]):
    """The newest of a kind, and how many there were. Guarded by the condition of `Hearing`.

    unreadable    what was wrong with the last message of this kind; "" if it could be read
    """

    def __init__(self) -> None:
        self.item: T | None = None
        self.count = 0
        self.heard_s = float("-inf")
        self.unreadable = ""

    def put(self, item: T) -> None:
        """A newer one."""
        self.item, self.heard_s, self.unreadable = item, time.monotonic(), ""
        self.count += 1

    @property
    def age_s(self) -> float:
        """Seconds since it came; infinite before the first."""
        return time.monotonic() - self.heard_s


class Hearing:
    """Keeps the last pose, its place in the map, the last status and whether the service is there.

    Zenoh's threads write, readers read and wait.
    """

    def __init__(self) -> None:
        self.pose: Newest[Heard] = Newest()
        self.map_odom: Newest[MapOdom] = Newest()
        self.status: Newest[Status] = Newest()
        self.is_alive = False
        self.is_closed = False
        self._run = 0  # how often the service was started
        self._news = threading.Condition()

    @property
    def unreadable(self) -> str:
        """What is wrong with the last pose, or else the last status; "" if nothing is."""
        return self.pose.unreadable or self.status.unreadable

    def subscribe(self, session: zenoh.Session, prefix: str) -> None:
        """Begin to listen. The token first: what comes after it is of its run."""
        alive = f"{prefix}/alive"
        session.liveliness().declare_subscriber(alive, self._take_token, history=True)
        session.declare_subscriber(f"{prefix}/status", self._take_status)
        session.declare_subscriber(f"{prefix}/map_odom", self._take_map_odom)
        session.declare_subscriber(f"{prefix}/odom", self._take_pose)

    def wait_until_alive(self, timeout_s: float | None) -> bool:
        """Until the service is there, or `close`; False if it is not in time."""
        with self._news:
            self._news.wait_for(lambda: self.is_closed or self.is_alive, timeout_s)
            return self.is_alive

    def wait_for_newer(
        self, newest: Newest[T], count: int, timeout_s: float | None
    ) -> tuple[int, T] | None:
        """The newest once there are more than `count`; None if none comes in time, or `close`."""
        with self._news:
            self._news.wait_for(lambda: self.is_closed or newest.count > count, timeout_s)
            if newest.item is None or newest.count <= count:
                return None
            return newest.count, newest.item

    def close(self) -> None:
        """Let go of all who wait."""
        with self._news:
            self.is_closed = True
            self._news.notify_all()

    def _take_token(self, sample: zenoh.Sample) -> None:
        with self._news:
            self.is_alive = sample.kind == zenoh.SampleKind.PUT
            self._run += self.is_alive
            if not self.is_alive:
                self.map_odom = Newest()  # an epoch's number says nothing about another run
            self._news.notify_all()

    def _take_status(self, sample: zenoh.Sample) -> None:
        with self._news, self._passing_over(self.status):
            self.status.put(read_status(sample.payload))

    def _take_pose(self, sample: zenoh.Sample) -> None:
        with self._news, self._passing_over(self.pose):
            self.pose.put(read_sample(sample, self._run))

    def _take_map_odom(self, sample: zenoh.Sample) -> None:
        with self._news, self._passing_over(self.map_odom):
            self.map_odom.put(read_map_odom(sample))

    @contextmanager
    def _passing_over(self, newest: Newest[T]) -> Iterator[None]:
        """Keep what is wrong with a message that cannot be read; log it when it is new."""
        try:
            yield
        except ValueError as error:
            if str(error) != newest.unreadable:
                logger.warning("passed over %s", error)
            newest.unreadable = str(error)
        self._news.notify_all()
