"""Lines that a log shows at its default level, although nothing is wrong."""

import logging

# Its own level counts, not the root's: the root's handlers show whatever is logged here.
_logger = logging.getLogger("kinect-vo.announcements")
_logger.setLevel(logging.INFO)


def announce(text: str) -> None:
    """Log a line at level info, shown unless only errors are wanted (``log.level = "error"``)."""
    if logging.getLogger().level <= logging.WARNING:
        _logger.info("%s", text)
