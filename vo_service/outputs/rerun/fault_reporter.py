"""What is wrong with the pictures: for the status while it lasts, for the log once."""

import logging
import time

# The same trouble is told again in the log after this long.
REPEAT_AFTER_S = 600.0

logger = logging.getLogger(__name__)


class RerunFaultReporter:
    """`warning` is what is wrong now, "" while all is well."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._logged_s: dict[str, float] = {}
        self.warning = ""

    def set(self, fault: str) -> None:
        """What is wrong from now on; "" if nothing is."""
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
            logger.info("rerun: pictures at %s again", self._address)
