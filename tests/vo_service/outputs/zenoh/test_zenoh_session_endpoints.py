"""Closing withdraws everything on a session, even after an error."""

import pytest
import zenoh

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import (
    EndpointConfig,
    ExtraEndpoints,
    LatestMessages,
    Queryables,
    SessionEndpoints,
)

pytestmark = pytest.mark.zenoh


def test_a_token_that_cannot_be_undeclared_keeps_nothing_else_open() -> None:
    config = EndpointConfig(
        "kinect",
        zenoh.CongestionControl.DROP,
        Queryables("kinect", LatestMessages()),
        ExtraEndpoints(),
    )
    with open_session(ZenohConfig(listen=())) as session:
        endpoints = SessionEndpoints(session, config)
        endpoints._alive.undeclare()  # type: ignore[no-untyped-call]  # a second time raises
        endpoints.close()
        assert session.is_closed()
