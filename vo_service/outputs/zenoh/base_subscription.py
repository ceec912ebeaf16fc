"""Subscriptions to messages of a robot's base, on the session of poses and commands."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from vo_service.outputs.zenoh.receiver import MAX_PENDING, start_receiver

MAX_PER_SECOND = 200.0
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
        return [start_receiver(subscriber, self.key, MAX_PER_SECOND, self._hand_over)]

    def _hand_over(self, sample: zenoh.Sample) -> None:
        if len(sample.payload) <= MAX_MESSAGE_BYTES:
            self.on_message(sample.payload.to_bytes())


def wheel_key(prefix: str) -> str:
    """Return the key of a service's wheels."""
    return f"{prefix}/wheel_odom"


def velocity_key(prefix: str) -> str:
    """Return the key of the velocities of a simulated base."""
    return f"{prefix}/cmd_vel"
