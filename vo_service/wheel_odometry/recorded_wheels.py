"""The odometry of wheels that was recorded with the frames, in the order of the recording."""

import logging
import math
from collections.abc import Callable, Iterator

from drivers.core import UserFacingError
from drivers.recording.odometry import ODOMETRY_TOPIC
from vo_service.config_tables import WheelOdometryConfig
from vo_service.wheel_odometry.wheel_odometry import WheelMotion, WheelOdometry

logger = logging.getLogger(__name__)


def recorded_topics(config: WheelOdometryConfig) -> tuple[str, ...]:
    """Return the topics to read from a recording."""
    return (
        (ODOMETRY_TOPIC,)
        if config.topic is None
        else (ODOMETRY_TOPIC, "/" + config.topic.lstrip("/"))
    )


class RecordedWheelOdometry(WheelOdometry):
    """Reads the messages up to the first one after each frame, so a replay repeats bit for bit.

    Args:
        config: See `WheelOdometry`.
        source: See `WheelOdometry`.
        open_messages: Opens the recorded messages; called at the first frame.
    """

    def __init__(
        self,
        config: WheelOdometryConfig,
        source: str,
        open_messages: Callable[[], Iterator[bytes]],
    ) -> None:
        super().__init__(config, source)
        self._open_messages = open_messages
        self._messages_ahead: Iterator[bytes] | None = None
        self._read_to_s = self._last_frame_s = -math.inf
        # The clock of the frames was set back; the messages until then are still to be read.
        self._is_before_step = False

    def motion_between(self, from_s: float, to_s: float) -> WheelMotion | None:
        """Read up to the present frame, then see `WheelOdometry`."""
        if to_s < self._last_frame_s:
            self._is_before_step = True
        self._last_frame_s = to_s
        while self._read_to_s < to_s or self._is_before_step:
            self._read_next()
        return super().motion_between(from_s, to_s)

    def _read_next(self) -> None:
        payload = self._next_message()
        if payload is None:
            self._read_to_s, self._is_before_step = math.inf, False
        elif (stamp_s := self.add_message(payload)) is not None:
            self._is_before_step &= stamp_s > self._read_to_s
            self._read_to_s = stamp_s

    def _next_message(self) -> bytes | None:
        """Return the next message; None at the end, or if the rest cannot be read."""
        if self._messages_ahead is None:
            self._messages_ahead = self._open_messages()
        try:
            return next(self._messages_ahead, None)
        except UserFacingError as error:
            logger.warning("wheel odometry: %s", error)
            return None
