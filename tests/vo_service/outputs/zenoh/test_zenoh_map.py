"""How `odom` lies in the map, over real Zenoh."""

import json
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import zenoh

from tests.vo_service.outputs.zenoh.query_helpers import (
    config,
    connected_session,
    query,
    reply_json,
)
from tests.vo_service.sample_map import make_map
from tests.waiting import wait_until
from vo_service.outputs.zenoh.cdr_transform import decode_transform
from vo_service.outputs.zenoh.output import LOCKSTEP_QOS, ZenohOutput
from vo_service.types import OdometryUpdate, Status

pytestmark = pytest.mark.zenoh

MakeUpdate = Callable[..., OdometryUpdate]
KEY = "kinect/map_odom"


@dataclass(frozen=True)
class Talk:
    """An output, and what is heard of it."""

    output: ZenohOutput
    session: zenoh.Session
    maps: list[zenoh.Sample]
    poses: list[zenoh.Sample]


@contextmanager
def talk_at(port: int) -> Iterator[Talk]:
    """Until the end of the block."""
    with (
        closing(ZenohOutput(config(port), LOCKSTEP_QOS)) as output,
        connected_session(port) as session,
    ):
        talk = Talk(output, session, [], [])
        session.declare_subscriber(KEY, talk.maps.append)
        session.declare_subscriber("kinect/odom", talk.poses.append)
        assert output.wait_for_subscriber(100)
        yield talk


def about(sample: zenoh.Sample) -> dict[str, Any]:
    """What is attached."""
    assert sample.attachment is not None
    found: dict[str, Any] = json.loads(sample.attachment.to_bytes())
    return found


def test_it_goes_out_with_its_frames_and_the_stamp_of_the_pose(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = replace(make_update(7), map=make_map())
    with talk_at(free_port) as talk:
        talk.output.on_update(update)
        wait_until(lambda: len(talk.maps) == 1)
    message = decode_transform(talk.maps[0].payload.to_bytes())
    assert str(talk.maps[0].encoding) == "application/cdr;geometry_msgs/msg/TransformStamped"
    assert (message.frame_id, message.child_frame_id) == ("map", "odom")
    assert message.stamp_s == update.stamp_s
    np.testing.assert_allclose(message.T_frame_child, update.map.T_map_odom, atol=1e-15)
    assert about(talk.maps[0]) == {
        "schema": 1, "seq": 7, "epoch": 1, "is_localized": True, "map_keyframes": 4, "loop_closures": 1,
    }  # fmt: skip


def test_it_goes_out_when_the_map_or_the_epoch_is_another(
    free_port: int, make_update: MakeUpdate
) -> None:
    first, second = make_map(), make_map(5)
    with talk_at(free_port) as talk:
        for seq, the_map, epoch in [
            (0, first, 0), (1, first, 0), (2, second, 0), (3, second, 0), (4, second, 1),
        ]:  # fmt: skip
            talk.output.on_update(replace(make_update(seq), map=the_map, epoch=epoch))
        wait_until(lambda: len(talk.maps) >= 3)
    assert [about(sample)["seq"] for sample in talk.maps] == [0, 2, 4]


def test_a_map_of_the_epoch_before_does_not_know_where_odom_lies(
    free_port: int, make_update: MakeUpdate
) -> None:
    with talk_at(free_port) as talk:
        for epoch in (1, 2):
            talk.output.on_update(replace(make_update(epoch), map=make_map(epoch=1), epoch=epoch))
        wait_until(lambda: len(talk.maps) >= 2)
    assert [about(sample)["is_localized"] for sample in talk.maps] == [True, False]


def test_it_goes_out_again_with_each_status_and_the_newest_stamp(
    free_port: int, make_update: MakeUpdate, status: Status
) -> None:
    the_map = make_map()
    with talk_at(free_port) as talk:
        for seq in (0, 1):
            talk.output.on_update(replace(make_update(seq), map=the_map))
        talk.output.on_status(status)
        talk.output.on_status(status)
        wait_until(lambda: len(talk.maps) >= 3)
    assert [about(sample)["seq"] for sample in talk.maps] == [0, 1, 1]


def test_nothing_goes_out_where_there_is_no_map(
    free_port: int, make_update: MakeUpdate, status: Status
) -> None:
    with talk_at(free_port) as talk:
        talk.output.on_update(make_update(0))
        talk.output.on_status(status)
        (refusal,) = map(reply_json, query(talk.session, KEY))
        talk.output.on_update(replace(make_update(1), map=make_map()))
        wait_until(lambda: len(talk.maps) >= 1)
    assert refusal == {"schema": 1, "error": "not-possible", "message": "there is no map yet"}
    assert [about(sample)["seq"] for sample in talk.maps] == [1]


def test_it_can_be_asked_for_and_has_the_stamp_of_the_newest_pose(
    free_port: int, make_update: MakeUpdate
) -> None:
    the_map = make_map(is_localized=False)
    with talk_at(free_port) as talk:
        for seq in range(6):
            talk.output.on_update(replace(make_update(seq), map=the_map))
        wait_until(lambda: seq_of(query(talk.session, KEY)) == 5)
        (reply,) = query(talk.session, KEY)
    assert reply.ok is not None
    assert about(reply.ok)["is_localized"] is False
    assert decode_transform(reply.ok.payload.to_bytes()).stamp_s == make_update(5).stamp_s


def seq_of(replies: list[zenoh.Reply]) -> int:
    """-1 for a refusal."""
    (reply,) = replies
    return int(about(reply.ok)["seq"]) if reply.ok else -1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_that_is_not_finite_is_kept_back_and_takes_no_pose_with_it(
    free_port: int, make_update: MakeUpdate, bad: float, caplog: pytest.LogCaptureFixture
) -> None:
    with talk_at(free_port) as talk:
        talk.output.on_update(
            replace(make_update(0), map=make_map(T_map_odom=np.full((4, 4), bad)))
        )
        talk.output.on_update(replace(make_update(1), map=make_map()))
        wait_until(lambda: len(talk.maps) >= 1)
        wait_until(lambda: {0, 1} <= {about(pose)["seq"] for pose in talk.poses})
    assert [about(sample)["seq"] for sample in talk.maps] == [1]
    assert "holds a number that is not finite" in caplog.text
    assert talk.output.errors == 1


def test_a_frame_of_another_name_is_taken_from_the_configuration(
    free_port: int, make_update: MakeUpdate
) -> None:
    named = config(free_port, map_frame_id="house", odom_frame_id="robot1/odom")
    with closing(ZenohOutput(named)) as output, connected_session(free_port) as session:
        output.on_update(replace(make_update(0), map=make_map()))
        wait_until(lambda: seq_of(query(session, KEY)) == 0)
        (reply,) = query(session, KEY)
    assert reply.ok is not None
    message = decode_transform(reply.ok.payload.to_bytes())
    assert (message.frame_id, message.child_frame_id) == ("house", "robot1/odom")
