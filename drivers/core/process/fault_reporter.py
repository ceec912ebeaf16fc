"""Something that goes wrong in the background, until it goes well again."""

import logging

logger = logging.getLogger(__name__)


class FaultReporter:
    """What went wrong with one kind of thing, until that goes well; the same is said only once."""

    def __init__(self, name: str) -> None:
        """`name` is what the log calls the process."""
        self.text = ""
        self._name = name

    def set(self, text: str) -> None:
        """Remember it, "" for none."""
        if text and text != self.text:
            logger.error("%s: %s", self._name, text)
        self.text = text
