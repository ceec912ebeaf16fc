"""Assembly of the messages of one frame by their stamp."""

import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh

from vo_service.client.pose import ReceivedPose, parse_pose_sample

# Frames that wait for the rest of their messages, and poses that wait for their frames.
MAX_INCOMPLETE_FRAMES = 8
MAX_WAITING_POSES = 256
POSE_TOPIC = "odom"
# Seconds and nanoseconds of the header, in CDR.
_STAMP = slice(4, 12)


@dataclass(frozen=True)
class AssembledFrame:
    """All messages of one stamp.

    Attributes:
        pose: The pose.
        payloads: By topic: the CDR message.
        attachment: JSON of one of the frame's messages.
    """

    pose: ReceivedPose
    payloads: Mapping[str, bytes]
    attachment: bytes


class FrameAssembly:
    """Subscribes to topics of the frames and to the poses; keeps the newest complete frame.

    Zenoh's threads store a message and return at once, so nothing piles up behind a slow reader.
    """

    def __init__(self, session: zenoh.Session, prefix: str, topics: Iterable[str]) -> None:
        self._topics = frozenset(topics)
        self._poses: dict[bytes, ReceivedPose] = {}
        self._payloads: dict[bytes, dict[str, bytes]] = {}
        self._attachment = b""
        self._newest: AssembledFrame | None = None  # that nobody has read
        self._is_closed = False
        self._changed = threading.Condition()
        self._subscribers = [
            session.declare_subscriber(f"{prefix}/{topic}", partial(self._on_sample, topic))
            for topic in (POSE_TOPIC, *self._topics)
        ]

    def wait_for_newest(self, timeout_s: float | None) -> AssembledFrame | None:
        """Wait for a frame that was not read yet; None on timeout or `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._is_closed, timeout_s)
            newest, self._newest = self._newest, None
            return None if self._is_closed else newest

    def stop(self) -> None:
        """Wake the reader, on another thread, and give it no more frames."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def close(self) -> None:
        """Unsubscribe."""
        self.stop()
        for subscriber in self._subscribers:
            with suppress(zenoh.ZError):  # the session has closed
                subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _on_sample(self, topic: str, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        stamp = payload[_STAMP]
        with self._changed:
            if topic == POSE_TOPIC:
                with suppress(ValueError):  # `ServiceState` reports it
                    self._poses[stamp] = parse_pose_sample(sample, run=0)
                _drop_oldest(self._poses, MAX_WAITING_POSES)
            else:
                self._payloads.setdefault(stamp, {})[topic] = payload
                _drop_oldest(self._payloads, MAX_INCOMPLETE_FRAMES)
                if sample.attachment is not None:
                    self._attachment = sample.attachment.to_bytes()
            self._complete(stamp)

    def _complete(self, stamp: bytes) -> None:
        payloads, pose = self._payloads.get(stamp, {}), self._poses.get(stamp)
        if pose is not None and payloads.keys() == self._topics:
            for older in list(self._payloads):
                del self._payloads[older]
                if older == stamp:
                    break
            self._newest = AssembledFrame(pose, payloads, self._attachment)
            self._changed.notify_all()


def _drop_oldest(items: dict[bytes, Any], capacity: int) -> None:
    while len(items) > capacity:
        del items[next(iter(items))]
