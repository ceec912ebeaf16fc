"""A base explores the virtual room by the map of a real `kinect-vo run`."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
import zenoh

from benchmarks.reconstruction import distances_m, make_solids
from drivers.core.geometry import Array
from drivers.ros_messages.decoding import decode_twist
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.driven_motion import DrivenMotion
from tests.examples.conftest import EXAMPLES, program
from tests.vo_service.service_runner import service_runner
from tests.waiting import wait_until
from vo_service.config import read_config

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

DRIVEN = EXAMPLES.parent / "config" / "driven.toml"
DRIVE_S, PLACES = 10.0, 2
# Heights of the base up to its camera, farther from the floor than the least distance.
MIN_DISTANCE_M, HEIGHTS_M = 0.2, (0.25, 0.375, 0.5)


class TrueBase:
    """Where the base is by the velocities that are sent to it."""

    def __init__(self, config: SyntheticConfig) -> None:
        self._motion, self._start_s = DrivenMotion(config), time.monotonic()

    @property
    def driven_s(self) -> float:
        """Seconds until now."""
        return time.monotonic() - self._start_s

    def on_velocity(self, sample: zenoh.Sample) -> None:
        """Drive as the simulated base does."""
        forward_m_s, *_, yaw_rad_s = decode_twist(sample.payload.to_bytes())
        self._motion.drive(self.driven_s, forward_m_s, yaw_rad_s)

    def points_m(self) -> Array:
        """Points (N, 3) of the base in the room, twenty times a second."""
        places = self._motion.poses(np.arange(0.0, self.driven_s, 0.05))[:, :3, 3]
        return np.concatenate([places * [1.0, 1.0, 0.0] + [0.0, 0.0, z] for z in HEIGHTS_M])


def client_session(endpoint: str) -> zenoh.Session:
    """Open a session that hears what others send to the service, which a peer does not."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("client"))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def test_a_base_explores_the_room_and_keeps_away_from_all_that_is_in_it(tmp_path: Path) -> None:
    config = read_config(DRIVEN).synthetic
    # Painted coarsely, which takes less time.
    coarse = DRIVEN.read_text().replace("texel_m = 0.004", "texel_m = 0.01")
    with service_runner(tmp_path, tmp_path, coarse.replace("schema = 1\n", "")) as stage:
        received = stage.start().received
        wait_until(lambda: bool(received.poses))
        base, endpoint = TrueBase(config), f"tcp/127.0.0.1:{stage.port}"
        with client_session(endpoint) as session, program("explore.py", endpoint) as lines:
            session.declare_subscriber("kinect/cmd_vel", base.on_velocity)
            for _ in range(1 + PLACES):  # the first one is the start
                lines.wait_for_line(r"^reached \[")
            wait_until(lambda: base.driven_s > DRIVE_S)
    points_m = base.points_m()
    assert distances_m(points_m, make_solids(config)).min() > MIN_DISTANCE_M
    assert np.ptp(points_m[:, :2], axis=0).max() > 1.0  # it did not stay where it was
