"""The occupancy grid over real Zenoh: on change, and for those who come later."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import zenoh

from drivers.ros_messages.decoding import decode_occupancy_grid
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import (
    config,
    connected_session,
    late_sample,
    query,
    reply_json,
)
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.outputs.zenoh.output import LOCKSTEP_QOS, ZenohOutput
from vo_service.types.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

pytestmark = pytest.mark.zenoh

FIRST = OccupancyGrid(np.array([[FREE, OCCUPIED, UNKNOWN]], np.int8), 0.05, (-1.0, 2.0))
SECOND = OccupancyGrid(np.array([[FREE, FREE, UNKNOWN]], np.int8), 0.05, (-1.0, 2.0))


def test_a_changed_grid_is_published_and_kept(free_port: int) -> None:
    samples: list[zenoh.Sample] = []
    with (
        closing(ZenohOutput(config(free_port), LOCKSTEP_QOS)) as output,
        connected_session(free_port) as session,
    ):
        session.declare_subscriber("kinect/odom", lambda _: None)
        session.declare_subscriber("kinect/map", samples.append)
        assert output.wait_for_subscriber(100)
        output.on_update(make_update(0))
        (refusal,) = map(reply_json, query(session, "kinect/map"))
        assert (
            refusal["message"]
            == "there is no occupancy grid yet; it needs the camera's height in T_base_camera"
        )
        for seq, grid in enumerate((FIRST, FIRST, SECOND, SECOND), start=1):
            output.on_update(replace(make_update(seq), grid=grid))
        wait_until(lambda: len(samples) == 2)
        late = decode_occupancy_grid(late_sample(session, "kinect/map"))
        with PoseClient(connect=f"tcp/127.0.0.1:{free_port}") as client:
            asked = client.grid()
    sent = decode_occupancy_grid(samples[0].payload.to_bytes())
    assert str(samples[0].encoding) == "application/cdr;nav_msgs/msg/OccupancyGrid"
    assert (sent.frame_id, sent.origin_xy_m) == ("map", FIRST.origin_xy_m)
    assert sent.stamp_s == pytest.approx(make_update(1).stamp_s, abs=1e-9)
    np.testing.assert_array_equal(sent.cells, FIRST.cells)
    for message in (late, asked):
        np.testing.assert_array_equal(message.cells, SECOND.cells)
