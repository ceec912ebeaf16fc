"""Checks of the caller's arguments, before anything is sent."""

import json
import re
import threading
from collections.abc import Mapping

from drivers.core.errors import InputError


def check_max_age(max_age_s: float) -> None:
    """Raise InputError unless the age is zero or more; infinity accepts any age."""
    if not max_age_s >= 0:
        raise InputError(f"max_age_s = {max_age_s:g}: give seconds, zero or more")


def check_timeout(timeout_s: float | None) -> None:
    """Raise InputError unless the timeout is None or a time that a thread can wait."""
    if timeout_s is not None and not 0 <= timeout_s <= threading.TIMEOUT_MAX:
        raise InputError(f"timeout_s = {timeout_s:g}: give seconds, zero or more and finite")


def check_command_name(name: str) -> None:
    """Raise InputError unless the name is one valid part of a Zenoh key."""
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise InputError(f"{name!r} is not a command name; see kinect-vo command --help")


def encode_arguments(key: str, arguments: Mapping[str, object]) -> bytes | None:
    """Encode arguments as JSON; None if there are none.

    Raises:
        InputError: If they are not valid.
    """
    if not arguments:
        return None
    try:
        return json.dumps(dict(arguments), allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{key}: the arguments cannot be sent as JSON: {error}") from error
