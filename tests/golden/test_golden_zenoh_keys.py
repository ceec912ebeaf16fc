"""The keys that a service declares over Zenoh: what subscribers, tools and rules name."""

from typing import Any

import pytest
import zenoh

from vo_service.config_tables import CommandConfig, ZenohConfig
from vo_service.control import CommandQueue
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import (
    EndpointConfig,
    ExtraEndpoints,
    LatestMessages,
    Queryables,
    SessionEndpoints,
    make_command_endpoint,
)

pytestmark = pytest.mark.zenoh

PUBLISHED = {"kinect/map_odom", "kinect/odom", "kinect/status"}
ANSWERED = {
    "kinect/latest",
    "kinect/map",
    "kinect/map_odom",
    "kinect/schema",
    "kinect/status",
}
COMMANDS = {"kinect/command/*"}
TOKENS = {"kinect/alive"}


class Declared:
    """Passes everything on to a session and keeps the keys that are declared on it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.publishers: set[str] = set()
        self.queryables: set[str] = set()
        self.tokens: set[str] = set()

    def declare_publisher(self, key: str, *args: Any, **options: Any) -> Any:
        self.publishers.add(key)
        return self._session.declare_publisher(key, *args, **options)

    def declare_queryable(self, key: str, *args: Any, **options: Any) -> Any:
        self.queryables.add(key)
        return self._session.declare_queryable(key, *args, **options)

    def liveliness(self) -> "Declared":
        return self

    def declare_token(self, key: str) -> Any:
        self.tokens.add(key)
        return self._session.liveliness().declare_token(key)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)


def declared() -> Declared:
    """What a service with default settings declares."""
    programme = EndpointConfig(
        "kinect",
        zenoh.CongestionControl.DROP,
        Queryables("kinect", LatestMessages()),
        ExtraEndpoints(make_command_endpoint(CommandConfig(), CommandQueue())),
    )
    with open_session(ZenohConfig(listen=())) as session:
        spy = Declared(session)
        SessionEndpoints(spy, programme).close()  # type: ignore[arg-type]
    return spy


def test_the_zenoh_keys_are_unchanged() -> None:
    found = declared()
    assert found.publishers == PUBLISHED
    assert found.queryables == ANSWERED | COMMANDS
    assert found.tokens == TOKENS
