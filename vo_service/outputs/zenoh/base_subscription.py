"""Subscriptions to messages of a robot's base, on the session of poses and commands."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from drivers.core.rate_limits import TokenBucket

# Many messages must not take CPU time from the poses: Zenoh drops the oldest, without Python code.
MAX_PENDING, MAX_PER_SECOND = 16, 200.0
# A message has less than a kilobyte.
MAX_MESSAGE_BYTES = 65_536


@dataclass(frozen=True)
class BaseSubscription:
    """Hands the messages of a key over, on a thread that ends with the session.

    Attributes:
        key: The key.
        on_message: Takes the payload of each message; it must not raise or block.
    """

    key: str
    on_message: Callable[[bytes], object]

    def declare(self, session: zenoh.Session) -> list[threading.Thread]:
        """Subscribe on a new session; return the thread."""
        subscriber = session.declare_subscriber(self.key, zenoh.handlers.RingChannel(MAX_PENDING))
        thread = threading.Thread(
            target=self._receive, args=(subscriber,), name=f"zenoh-{self.key}", daemon=True
        )
        thread.start()
        return [thread]

    def _receive(self, subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]) -> None:
        rate_limit = TokenBucket(MAX_PER_SECOND)
        samples = subscriber.handler
        while True:
            time.sleep(rate_limit.seconds_until_next())
            try:
                payload = samples.recv().payload
            except zenoh.ZError:  # the session has closed
                return
            rate_limit.try_acquire()
            if len(payload) <= MAX_MESSAGE_BYTES:
                self.on_message(payload.to_bytes())


def wheel_key(prefix: str) -> str:
    """Return the key of a service's wheels."""
    return f"{prefix}/wheel_odom"


def velocity_key(prefix: str) -> str:
    """Return the key of the velocities of a simulated base."""
    return f"{prefix}/cmd_vel"
