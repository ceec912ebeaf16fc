"""Commands to a running kinect-vo, over Zenoh."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

TIMEOUT_S = 6.0
_ZENOH_TIMEOUT = b"Timeout"


class CommandError(Exception):
    """A command was refused or got no reply; the text is for people."""


class CommandClient:
    """Sends commands.

    Args:
        prefix: Prefix of the service's keys.
        get_session: Returns the open session; None if there is none.
    """

    def __init__(self, prefix: str, get_session: Callable[[], zenoh.Session | None]) -> None:
        self._prefix, self._get_session = prefix, get_session

    def send(self, name: str, arguments: Mapping[str, object] | None = None) -> Mapping[str, Any]:
        """Send a command and wait for its reply.

        Args:
            name: Name of the command, such as "save-map".
            arguments: Its arguments.

        Returns:
            The reply: JSON.

        Raises:
            CommandError: With the service's message if it refuses.
        """
        session = self._get_session()
        if session is None:
            raise CommandError("kinect-vo cannot be reached")
        key = f"{self._prefix}/command/{name}"
        payload = json.dumps(dict(arguments), allow_nan=False).encode() if arguments else None
        try:
            replies = list(session.get(key, payload=payload, timeout=TIMEOUT_S))
        except zenoh.ZError as error:
            raise CommandError(f"kinect-vo cannot be reached: {error}") from error
        for reply in replies:
            if reply.ok is not None:
                return _parse(reply.ok.payload)
            if reply.err is not None and reply.err.payload.to_bytes() != _ZENOH_TIMEOUT:
                raise CommandError(str(_parse(reply.err.payload).get("message", "refused")))
        raise CommandError("no kinect-vo answers: none is running, or access is denied")


def _parse(payload: zenoh.ZBytes) -> Mapping[str, Any]:
    try:
        content = json.loads(payload.to_bytes())
    except ValueError:
        content = None
    if not isinstance(content, dict):
        raise CommandError("the reply is not a JSON object")
    return content
