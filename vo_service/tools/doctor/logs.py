"""Logging while the doctor runs: errors on the console, details in a file."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OWN_LOGGERS = ("drivers", "vo_service", "kinect-vo")


@contextmanager
def quiet_console() -> Iterator[None]:
    """Show only errors on the console; findings repeat the drivers' warnings."""
    levels = [(handler, handler.level) for handler in logging.getLogger().handlers]
    for handler, level in levels:
        handler.setLevel(max(level, logging.ERROR))
    try:
        yield
    finally:
        for handler, level in levels:
            handler.setLevel(level)


@contextmanager
def log_details_to(file: Path) -> Iterator[None]:
    """Log everything to a file as well; other handlers do not change.

    Raises:
        OSError: If that fails.
    """
    root = logging.getLogger()
    before = root.level
    levels = [(handler, handler.level) for handler in root.handlers]
    detailed = logging.FileHandler(file)
    detailed.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    # Details of other packages would hide ours.
    detailed.addFilter(lambda record: record.levelno > logging.INFO or _is_ours(record.name))
    for handler, level in levels:
        handler.setLevel(max(level, before))
    root.addHandler(detailed)
    root.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        root.setLevel(before)
        root.removeHandler(detailed)
        detailed.close()
        for handler, level in levels:
            handler.setLevel(level)


def _is_ours(logger: str) -> bool:
    return logger.partition(".")[0] in OWN_LOGGERS
