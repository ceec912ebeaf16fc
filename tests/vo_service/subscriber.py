"""What a subscriber hears of a kinect-vo, in this process and over the real Zenoh."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
import zenoh

from drivers.core.geometry import Array
from drivers.ros_messages.decoding import decode_odometry
from drivers.ros_messages.navigation import OdometryMessage

StatusContent = Mapping[str, Any]


@dataclass(frozen=True)
class SubscribedPose:
    """A pose, when it was received (CLOCK_MONOTONIC), and whether all its numbers are finite."""

    receive_time_s: float
    stamp_s: float
    seq: int
    epoch: int
    state: str
    reason: str
    position_m: Array
    is_finite: bool


@dataclass(frozen=True)
class SubscribedStatus:
    """A status, and when it was received."""

    receive_time_s: float
    content: StatusContent

    def has_camera_reason(self, text: str) -> bool:
        """Whether it gives this as the reason for having no camera."""
        return self.content["state"] == "no_camera" and text in self.content["reason"]

    def has_warning(self, text: str) -> bool:
        """Whether one of its warnings has these words."""
        return any(text in warning for warning in self.content["warnings"])


class RecordingSubscriber:
    """Keeps all poses and statuses of one publisher, in the order in which they came."""

    def __init__(self) -> None:
        self.poses: list[SubscribedPose] = []
        self.statuses: list[SubscribedStatus] = []
        self.unreadable: list[str] = []
        self._news = threading.Condition()

    def on_pose(self, sample: zenoh.Sample) -> None:
        """From Zenoh, which would only print what is raised."""
        with self._record_unreadable(sample):
            self._add_pose(sample)

    def on_status(self, sample: zenoh.Sample) -> None:
        """From Zenoh."""
        with self._record_unreadable(sample):
            self._add_status(sample)

    def wait_for(self, holds: Callable[[], bool], limit_s: float) -> bool:
        """Until something holds of what was received; False if it does not in time."""
        with self._news:
            return self._news.wait_for(holds, limit_s)

    @contextmanager
    def _record_unreadable(self, sample: zenoh.Sample) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.unreadable.append(f"{sample.key_expr}: {error!r}")

    def _add_pose(self, sample: zenoh.Sample) -> None:
        received_s = time.monotonic()
        message = decode_odometry(sample.payload.to_bytes())
        attachment = sample.attachment
        assert attachment is not None
        about = parse_strict_json(attachment.to_bytes())
        pose = SubscribedPose(
            receive_time_s=received_s,
            stamp_s=message.stamp_s,
            seq=about["seq"],
            epoch=about["epoch"],
            state=about["state"],
            reason=about["reason"],
            position_m=message.position_m,
            is_finite=_is_finite(message),
        )
        with self._news:
            self.poses.append(pose)
            self._news.notify_all()

    def _add_status(self, sample: zenoh.Sample) -> None:
        content = parse_strict_json(sample.payload.to_bytes())
        with self._news:
            self.statuses.append(SubscribedStatus(time.monotonic(), content))
            self._news.notify_all()


def parse_strict_json(payload: bytes) -> Any:
    """As the standard has it, where NaN and Infinity are no numbers."""
    return json.loads(payload, parse_constant=_reject_constant)


def _reject_constant(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no JSON")


def _is_finite(message: OdometryMessage) -> bool:
    numbers = (message.T_frame_child, message.pose_covariance, message.twist)
    all_numbers = [*numbers, message.twist_covariance]
    return math.isfinite(message.stamp_s) and all(np.isfinite(n).all() for n in all_numbers)
