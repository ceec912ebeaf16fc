"""The map->odom transform over real Zenoh."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest
import zenoh

from drivers.ros_messages.decoding import decode_transform
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.outputs.zenoh.query_helpers import (
    attachment_of,
    config,
    connected_session,
    queried_seq,
    query,
    reply_json,
)
from tests.vo_service.sample_map import make_map
from tests.waiting import wait_until
from vo_service.config_tables import FrameIds
from vo_service.outputs.zenoh.output import LOCKSTEP_QOS, ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints

pytestmark = pytest.mark.zenoh

KEY = "kinect/map_odom"


@dataclass(frozen=True)
class OutputAndSession:
    """An output, and the samples received from it."""

    output: ZenohOutput
    session: zenoh.Session
    maps: list[zenoh.Sample]
    poses: list[zenoh.Sample]


@contextmanager
def connected_output(port: int) -> Iterator[OutputAndSession]:
    """Run an output and subscribe to it while the block runs."""
    with (
        closing(ZenohOutput(config(port), LOCKSTEP_QOS)) as output,
        connected_session(port) as session,
    ):
        connected = OutputAndSession(output, session, [], [])
        session.declare_subscriber(KEY, connected.maps.append)
        session.declare_subscriber("kinect/odom", connected.poses.append)
        assert output.wait_for_subscriber(100)
        yield connected


def test_a_map_transform_has_its_frames_and_the_stamp_of_the_pose(free_port: int) -> None:
    update = replace(make_update(7), map=make_map())
    with connected_output(free_port) as connected:
        connected.output.on_update(update)
        wait_until(lambda: len(connected.maps) == 1)
    message = decode_transform(connected.maps[0].payload.to_bytes())
    assert str(connected.maps[0].encoding) == "application/cdr;geometry_msgs/msg/TransformStamped"
    assert (message.frame_id, message.child_frame_id) == ("map", "odom")
    assert message.stamp_s == update.stamp_s
    np.testing.assert_allclose(message.T_frame_child, update.map.T_map_odom, atol=1e-15)
    assert attachment_of(connected.maps[0]) == {
        "schema": 1, "seq": 7, "epoch": 1, "is_localized": True,
        "map_keyframes": 4, "loop_closures": 1,
    }  # fmt: skip


def test_a_map_transform_is_published_when_the_map_or_the_epoch_changes(free_port: int) -> None:
    first, second = make_map(epoch=1), make_map(5, epoch=1)
    with connected_output(free_port) as connected:
        for seq, snapshot, epoch in [
            (0, first, 1), (1, first, 1), (2, second, 1), (3, second, 1), (4, second, 2),
        ]:  # fmt: skip
            connected.output.on_update(replace(make_update(seq), map=snapshot, epoch=epoch))
        wait_until(lambda: len(connected.maps) >= 3)
    attachments = [attachment_of(sample) for sample in connected.maps]
    assert [each["seq"] for each in attachments] == [0, 2, 4]
    # A map of the previous epoch is not localized.
    assert [each["is_localized"] for each in attachments] == [True, True, False]


def test_a_map_transform_is_published_with_each_status_and_the_newest_stamp(free_port: int) -> None:
    snapshot = make_map()
    with connected_output(free_port) as connected:
        for seq in (0, 1):
            connected.output.on_update(replace(make_update(seq), map=snapshot))
        connected.output.on_status(STATUS)
        connected.output.on_status(STATUS)
        wait_until(lambda: len(connected.maps) >= 3)
    assert [attachment_of(sample)["seq"] for sample in connected.maps] == [0, 1, 1]


def test_a_map_that_is_lost_while_no_poses_come_is_not_localized(free_port: int) -> None:
    lost = replace(STATUS, map=replace(STATUS.map, is_localized=False))
    with connected_output(free_port) as connected:
        connected.output.on_update(replace(make_update(0), map=make_map()))
        connected.output.on_status(lost)
        wait_until(lambda: len(connected.maps) == 2)
        (reply,) = query(connected.session, KEY)
        connected.output.on_update(replace(make_update(1), map=make_map()))  # localized again
        wait_until(lambda: len(connected.maps) == 3)
    assert reply.ok is not None
    assert attachment_of(reply.ok)["is_localized"] is False
    attachments = [attachment_of(sample) for sample in connected.maps]
    assert [each["is_localized"] for each in attachments] == [True, False, True]


def test_without_a_map_no_transform_is_published(free_port: int) -> None:
    with connected_output(free_port) as connected:
        connected.output.on_update(make_update(0))
        connected.output.on_status(STATUS)
        (refusal,) = map(reply_json, query(connected.session, KEY))
        connected.output.on_update(replace(make_update(1), map=make_map()))
        wait_until(lambda: len(connected.maps) >= 1)
    assert refusal == {"schema": 1, "error": "not-possible", "message": "there is no map yet"}
    assert [attachment_of(sample)["seq"] for sample in connected.maps] == [1]


def test_a_map_transform_can_be_queried_with_the_stamp_of_the_newest_pose(free_port: int) -> None:
    snapshot = make_map(is_localized=False)
    with connected_output(free_port) as connected:
        for seq in range(6):
            connected.output.on_update(replace(make_update(seq), map=snapshot))
        wait_until(lambda: queried_seq(connected.session, KEY) == 5)
        (reply,) = query(connected.session, KEY)
    assert reply.ok is not None
    assert attachment_of(reply.ok)["is_localized"] is False
    assert decode_transform(reply.ok.payload.to_bytes()).stamp_s == make_update(5).stamp_s


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_map_transform_that_is_not_finite_is_not_published_but_its_pose_is(
    free_port: int, bad: float, caplog: pytest.LogCaptureFixture
) -> None:
    with connected_output(free_port) as connected:
        connected.output.on_update(
            replace(make_update(0), map=make_map(T_map_odom=np.full((4, 4), bad)))
        )
        connected.output.on_update(replace(make_update(1), map=make_map()))
        wait_until(lambda: len(connected.maps) >= 1)
        wait_until(lambda: {0, 1} <= {attachment_of(pose)["seq"] for pose in connected.poses})
    assert [attachment_of(sample)["seq"] for sample in connected.maps] == [1]
    assert "has a number that is not finite" in caplog.text
    assert connected.output.errors == 1


def test_the_frame_names_are_those_of_the_configuration(free_port: int) -> None:
    names = FrameIds(map_frame_id="house", odom_frame_id="robot1/odom")
    extras = ExtraEndpoints(frame_ids=names)
    with (
        closing(ZenohOutput(config(free_port), extra_endpoints=extras)) as output,
        connected_session(free_port) as session,
    ):
        output.on_update(replace(make_update(0), map=make_map()))
        wait_until(lambda: queried_seq(session, KEY) == 0)
        (reply,) = query(session, KEY)
    assert reply.ok is not None
    message = decode_transform(reply.ok.payload.to_bytes())
    assert (message.frame_id, message.child_frame_id) == ("house", "robot1/odom")
