"""The map on /tf, as a ROS 2 node receives it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zenoh

from drivers.core.geometry import rigid_transform
from tests.vo_service.outputs.zenoh.ros_node import ROS, TF_KEY, receive_published
from tests.vo_service.sample_map import make_map
from vo_service.types.map_snapshot import NO_MAP, MapSnapshot
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh

MakeUpdate = Callable[..., OdometryUpdate]


def transforms(sample: zenoh.Sample) -> list[tuple[str, str, float]]:
    """Return frames and x of a sample's transforms, which must have one stamp."""
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "tf2_msgs/msg/TFMessage")
    assert len({(t.header.stamp.sec, t.header.stamp.nanosec) for t in message.transforms}) == 1
    return [
        (t.header.frame_id, t.child_frame_id, t.transform.translation.x) for t in message.transforms
    ]


def test_with_a_map_a_node_gets_its_transform_and_that_of_the_base(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = replace(make_update(2), map=make_map(T_map_odom=rigid_transform(np.eye(3), [5, 0, 0])))
    (sample,) = receive_published(free_port, [update], 1, TF_KEY)
    assert transforms(sample) == [
        ("odom", "base_link", update.T_odom_base[0, 3]),
        ("map", "odom", 5.0),
    ]


@pytest.mark.parametrize(
    "snapshot",
    [
        NO_MAP,
        make_map(is_localized=False),
        make_map(epoch=0),
        make_map(T_map_odom=np.full((4, 4), np.nan)),
    ],
    ids=["none", "not located", "of the epoch before", "not finite"],
)
def test_without_a_localized_map_a_node_gets_only_the_base(
    free_port: int, make_update: MakeUpdate, snapshot: MapSnapshot
) -> None:
    update = replace(make_update(2), map=snapshot)
    (sample,) = receive_published(free_port, [update], 1, "tf")
    assert transforms(sample) == [("odom", "base_link", update.T_odom_base[0, 3])]
