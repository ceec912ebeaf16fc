"""Fault of the Rerun output: in the status while it lasts, in the log once."""

import logging
import time

# The same fault is logged again after this long.
REPEAT_AFTER_S = 600.0

logger = logging.getLogger(__name__)


class RerunFaultReporter:
    """Reporter of the current fault.

    Attributes:
        warning: The current fault, "" if there is none.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._logged_s: dict[str, float] = {}
        self.warning = ""

    def set(self, fault: str) -> None:
        """Set the current fault; "" clears it."""
        if not fault:
            self._clear()
            return
        self.warning = f"rerun: {fault}"
        if time.monotonic() - self._logged_s.get(fault, float("-inf")) > REPEAT_AFTER_S:
            self._logged_s[fault] = time.monotonic()
            logger.warning("%s", self.warning)

    def _clear(self) -> None:
        if self.warning:
            self.warning = ""
            logger.info("rerun: drawing at %s again", self._address)
