"""The latest messages of one service, for any number of readers."""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import zenoh

from vo_service.client.map_odom import MapOdom, parse_map_odom
from vo_service.client.message_parsing import parse_status
from vo_service.client.pose import ReceivedPose, parse_pose_sample
from vo_service.types import JsonObject

logger = logging.getLogger(__name__)

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
            latest: Latest message of the kind.
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
            self.is_closed = True
            self._changed.notify_all()

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.is_alive = sample.kind == zenoh.SampleKind.PUT
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
