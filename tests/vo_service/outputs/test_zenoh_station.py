"""What is declared on a session goes with it, whatever fails on the way."""

import pytest
import zenoh

from vo_service.outputs.zenoh_commands import NoCommands
from vo_service.outputs.zenoh_messages import Frames
from vo_service.outputs.zenoh_questions import Memory, Questions
from vo_service.outputs.zenoh_session import open_session
from vo_service.outputs.zenoh_station import Programme, Station
from vo_service.settings import Ros2Settings, ZenohConfig

pytestmark = pytest.mark.zenoh


def test_a_token_that_cannot_be_taken_back_keeps_nothing_else_open() -> None:
    programme = Programme(
        "kinect",
        Frames("odom", "base_link", "map"),
        zenoh.CongestionControl.DROP,
        Questions("kinect", Memory()),
        NoCommands(),
        Ros2Settings(enabled=True),
    )
    with open_session(ZenohConfig(listen=())) as session:
        station = Station(session, programme)
        station._alive.undeclare()  # type: ignore[no-untyped-call]  # a second time raises
        station.close()
        assert session.is_closed()
