"""Zenoh sessions to a running kinect-vo: opened when it can be reached, however late."""

import json
import resource
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zenoh

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7450"
RETRY_S = 1.0
_CLIENT_CONNECT_TIMEOUT_MS = 2000
# Points of every pixel have 5 MB.
_MAX_MESSAGE_BYTES = 8 << 20
# Zenoh locks the shared memory of a publisher.
_LOCKED_BYTES = 8_000_000
_TLS_FILES = ("root_ca_certificate", "connect_private_key", "connect_certificate")


class SettingsError(Exception):
    """The settings of the connection are wrong, so that trying again cannot help."""


@dataclass(frozen=True)
class ConnectionSettings:
    """Where kinect-vo is.

    Attributes:
        connect: Zenoh endpoint; used unless the file has endpoints.
        config_file: Zenoh configuration in JSON5, such as one with certificates; "" = none.
    """

    connect: str = DEFAULT_ENDPOINT
    config_file: str = ""

    def zenoh_config(self) -> zenoh.Config:
        """Make Zenoh's configuration: nothing listens, nothing scouts.

        Raises:
            SettingsError: The endpoint or the file is not valid.
        """
        settings, default = self._read_file(), zenoh.Config()
        ours = {
            "mode": "peer",
            "listen/endpoints": [],
            "connect/endpoints": [self.connect],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": _may_lock_memory(),
            "transport/shared_memory/transport_optimization/enabled": False,
            "transport/link/rx/max_message_size": _MAX_MESSAGE_BYTES,
        }
        for key, value in ours.items():
            if settings.get_json(key) != default.get_json(key):
                continue  # the file's
            try:
                settings.insert_json5(key, json.dumps(value))
            except zenoh.ZError:
                raise SettingsError(
                    f"connect = {self.connect!r}: an endpoint is written PROTOCOL/ADDRESS:PORT, "
                    f"such as {DEFAULT_ENDPOINT}"
                ) from None
        if settings.get_json("mode") == '"client"':  # it would wait forever for its router
            settings.insert_json5("connect/timeout_ms", str(_CLIENT_CONNECT_TIMEOUT_MS))
        return settings

    def _read_file(self) -> zenoh.Config:
        if not self.config_file:
            return zenoh.Config()
        file = Path(self.config_file)
        try:
            settings = zenoh.Config.from_json5(file.read_text())
        except (OSError, UnicodeDecodeError, zenoh.ZError) as error:
            reason = " ".join(str(error).split())
            raise SettingsError(f"config_file: {file}: cannot be read: {reason}") from None
        for name in _TLS_FILES:  # a relative name is relative to the file
            key = f"transport/link/tls/{name}"
            if value := json.loads(settings.get_json(key)):
                path = file.absolute().parent / value
                if not path.is_file():
                    raise SettingsError(f"config_file: {file}: {name}: there is no file {path}")
                settings.insert_json5(key, json.dumps(str(path)))
        return settings


def _may_lock_memory() -> bool:
    """Whether shared memory can be used; without the right to lock it, no image would arrive."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return limit == resource.RLIM_INFINITY or limit >= _LOCKED_BYTES


class PersistentSession:
    """A Zenoh session that is opened in the background, again and again until it succeeds.

    Once it is open, Zenoh itself connects again after an interruption.

    Args:
        settings: Where kinect-vo is.
        on_open: Called once, on another thread, with the open session.
        on_failure: Called on that thread with the reason of a failed attempt.
    """

    def __init__(
        self,
        settings: ConnectionSettings,
        on_open: Callable[[zenoh.Session], None],
        on_failure: Callable[[str], None],
    ) -> None:
        self._config = settings.zenoh_config()
        self._on_open, self._on_failure = on_open, on_failure
        self._closed = threading.Event()
        self._session: zenoh.Session | None = None
        self._thread = threading.Thread(target=self._open, name="zenoh-open", daemon=True)
        self._thread.start()

    @property
    def session(self) -> zenoh.Session | None:
        """The session; None until it is open."""
        return self._session

    def close(self) -> None:
        """Close the session, or stop trying to open it."""
        self._closed.set()
        self._thread.join()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def _open(self) -> None:
        while not self._closed.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError as error:
                self._on_failure(" ".join(str(error).split()))
                self._closed.wait(RETRY_S)
                continue
            self._on_open(session)
            self._session = session
            return
