"""The current fault of a background process, logged once."""

import logging

logger = logging.getLogger(__name__)


class FaultReporter:
    """Holds the current fault in `text` ("" for none) and logs each new fault once.

    Args:
        name: Name of the process in the log.
    """

    def __init__(self, name: str) -> None:
        self.text = ""
        self._name = name

    def set(self, text: str) -> None:
        """Set the current fault, "" for none."""
        if text and text != self.text:
            logger.error("%s: %s", self._name, text)
        self.text = text
