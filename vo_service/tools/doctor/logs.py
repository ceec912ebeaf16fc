"""The program's log while the doctor is at work: quiet on the screen, in detail in a file."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

OWN_LOGGERS = ("drivers", "vo_service", "kinect-vo")


@contextmanager
def quiet_console() -> Iterator[None]:
    """Only errors reach the screen: what a driver warns of comes as a finding as well."""
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
    """Everything goes to a file; what goes elsewhere stays as it is. Raises OSError."""
    root = logging.getLogger()
    before = root.level
    levels = [(handler, handler.level) for handler in root.handlers]
    detailed = logging.FileHandler(file)
    detailed.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    # The details of other packages would drown ours.
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
