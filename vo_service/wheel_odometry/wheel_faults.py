"""What is wrong with the wheels' messages, for the status and the log."""

import logging
import math

from vo_service.types.failure_reasons import strip_numbers

logger = logging.getLogger(__name__)

# A fault of one message is in the status for so long.
MESSAGE_FAULT_S = 1.0
# Without a new pose for so long, the wheels' driver has stopped.
SILENCE_S = 0.5
# Stamps that are further ahead, or too old, for so long are those of another clock.
MAX_AHEAD_S, OFFSET_S = 0.5, 1.0
LOG_PERIOD_S = 60.0


class TimedFault:
    """A fault of one moment, which counts for a while.

    Attributes:
        text: The fault; "" without one.
    """

    def __init__(self) -> None:
        self.text = ""
        self._until_s: float | None = None

    def set(self, text: str) -> None:
        """Set the fault; its time begins at the next frame."""
        self.text, self._until_s = text, None

    def advance(self, now_s: float) -> None:
        """Clear the fault after `MESSAGE_FAULT_S`, or if the clock was set."""
        if self._until_s is None:
            self._until_s = now_s + MESSAGE_FAULT_S
        if not self._until_s - MESSAGE_FAULT_S <= now_s < self._until_s:
            self.text = ""


class ArrivalFault:
    """Poses that do not come, or have the stamps of another clock.

    Args:
        source: Where the messages come from, for people.
        max_age_s: Age from which a pose is not used.

    Attributes:
        text: The fault; "" without one.
        is_offset: Whether the stamps are those of another clock.
    """

    def __init__(self, source: str, max_age_s: float) -> None:
        self._source, self._max_age_s = source, max_age_s
        self.text, self.is_offset = "", False
        self._now_s = math.inf
        self._newest_s: float | None = None
        # Frame at which the newest pose changed, and the number of messages then.
        self._changed_s, self._changed_messages = 0.0, 0
        self._in_time_s = 0.0

    def advance(self, now_s: float, newest_s: float | None, messages: int) -> None:
        """Find the fault at a frame.

        Args:
            now_s: Its stamp.
            newest_s: Stamp of the newest pose; None without one.
            messages: Number of messages since the start, readable or not.
        """
        if now_s < self._now_s:  # the first frame, or the clock was set back
            self._in_time_s = now_s
        if now_s < self._now_s or newest_s != self._newest_s:
            self._changed_s, self._changed_messages = now_s, messages
        self._now_s, self._newest_s = now_s, newest_s
        silent_s = now_s - self._changed_s
        self.text, self.is_offset = "", False
        if silent_s > SILENCE_S:
            self._in_time_s = now_s
            self.text = self._silence(silent_s, has_messages=messages > self._changed_messages)
        elif newest_s is not None:
            self._check_age(now_s, now_s - newest_s)

    def _silence(self, silent_s: float, *, has_messages: bool) -> str:
        if has_messages:
            return f"the stamps on {self._source} stand still"
        if self._newest_s is None:
            return f"no message on {self._source}"
        return f"no message on {self._source} for {silent_s:.1f} s"

    def _check_age(self, now_s: float, age_s: float) -> None:
        if -MAX_AHEAD_S <= age_s <= self._max_age_s:
            self._in_time_s = now_s
        if now_s - self._in_time_s <= OFFSET_S:
            return
        self.is_offset = True
        side = "old" if age_s > 0.0 else "ahead"
        self.text = (
            f"the newest pose is {abs(age_s):.2f} s {side}: synchronize the clocks of wheels and "
            "camera"
        )


class FaultLog:
    """Logs each kind of fault once a minute, in the time of the frames."""

    def __init__(self) -> None:
        self._logged_s: dict[str, float] = {}

    def add(self, fault: str, now_s: float) -> None:
        """Log a fault, unless it was logged; "" is none."""
        kind = strip_numbers(fault)
        logged_s = self._logged_s.get(kind, -math.inf)
        if fault and not logged_s <= now_s < logged_s + LOG_PERIOD_S:
            self._logged_s[kind] = now_s
            logger.warning("%s", fault)
