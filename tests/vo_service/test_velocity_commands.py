"""Messages that drive a simulated base."""

import math
import struct

import numpy as np
import pytest

from drivers.ros_messages.cdr import CDR_HEADER
from drivers.ros_messages.navigation import encode_twist
from tests.vo_service.fakes import ScriptedCamera
from vo_service.velocity_commands import VelocityCommands

DRIVE = encode_twist(np.array([0.3, 0.1, 0.0, 0.0, 0.0, -0.5]))
NOT_FINITE = CDR_HEADER + struct.pack("<6d", math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)


class Base(ScriptedCamera):
    """Keeps the velocities that it is sent."""

    def __init__(self) -> None:
        super().__init__([])
        self.velocities: list[tuple[float, float]] = []

    def set_velocity(self, forward_m_s: float, yaw_rad_s: float) -> None:
        """Keep them."""
        self.velocities.append((forward_m_s, yaw_rad_s))


def test_a_twist_drives_the_base() -> None:
    base = Base()
    velocities = VelocityCommands(base, "kinect/cmd_vel")
    velocities.add_message(DRIVE)
    assert base.velocities == [(0.3, -0.5)]
    assert velocities.warning == ""


@pytest.mark.parametrize("payload", [NOT_FINITE, b"", b"no twist", DRIVE[:-1], DRIVE + bytes(8)])
def test_nonsense_stops_the_base_with_one_warning_until_a_twist_comes(
    payload: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    base = Base()
    velocities = VelocityCommands(base, "kinect/cmd_vel")
    for message in (DRIVE, payload, payload):
        velocities.add_message(message)
    assert base.velocities[1:] == [(0.0, 0.0), (0.0, 0.0)]
    assert "stopped, a message on kinect/cmd_vel is not used" in velocities.warning
    assert [record.message for record in caplog.records] == [velocities.warning]
    velocities.add_message(DRIVE)
    assert velocities.warning == ""
