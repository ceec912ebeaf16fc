"""Reading how odom lies in the map."""

import numpy as np
import pytest

from tests.vo_service.client.fake_service import (
    ServiceAndClient,
    find_free_endpoint,
    publish_and_receive,
    running_fake_service,
)
from tests.waiting import wait_until
from vo_service.client import CommandRefused, MapOdom, PoseClient

pytestmark = pytest.mark.zenoh


def heard(talk: ServiceAndClient, seq: int) -> MapOdom:
    """What the client gives out once this has come."""
    publisher, client = talk
    publisher.publish_map_odom(
        2.0, seq=seq, epoch=1, is_localized=False, map_keyframes=7, loop_closures=2
    )

    def is_there() -> bool:
        found = client._state.map_odom.item
        return found is not None and found.seq == seq

    wait_until(is_there)
    return client.map_odom()


def test_it_has_all_that_the_message_says(talk: ServiceAndClient) -> None:
    found = heard(talk, 7)
    assert (found.stamp_s, found.frame_id, found.child_frame_id) == (12.5, "map", "odom")
    assert (found.seq, found.epoch, found.is_localized) == (7, 1, False)
    assert (found.map_keyframes, found.loop_closures) == (7, 2)
    np.testing.assert_allclose(found.T_map_odom[:3, 3], [0.0, 2.0, 0.0])
    assert 0 <= found.age_s < 20


def test_a_pose_in_the_map_is_one_product(talk: ServiceAndClient) -> None:
    publisher, client = talk
    pose = publish_and_receive(publisher, client.poses(), 8, x_m=1.0)
    T_map_base = heard(talk, 8).T_map_odom @ pose.T_odom_base
    np.testing.assert_allclose(T_map_base[:3, 3], [1.0, 2.5, -0.25])


def test_a_service_without_a_map_says_so() -> None:
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as publisher:
        publisher.answer_with(
            "map_odom", {"error": "not-possible", "message": "there is no map yet"}
        )
        with PoseClient(connect=endpoint) as client:
            publisher.wait_for_reader()
            with pytest.raises(CommandRefused, match="there is no map yet"):
                client.map_odom(timeout_s=100)


@pytest.mark.parametrize(
    ("payload", "attachment", "words"),
    [
        (
            b"nonsense",
            b'{"schema": 1, "seq": 1}',
            "without epoch, is_localized, loop_closures, map_keyframes",
        ),
        (b"", None, "without its attachment"),
        (b"", b'{"schema": 2}', "a message of version 2, only 1 is known here"),
        (
            b"nonsense",
            b'{"schema": 1, "seq": 1, "epoch": 0, "is_localized": true, "map_keyframes": 1, "loop_closures": 0}',
            "CDR",
        ),
    ],
)
def test_one_that_cannot_be_read_is_passed_over_and_the_next_one_read(
    talk: ServiceAndClient,
    payload: bytes,
    attachment: bytes | None,
    words: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    publisher, client = talk
    publisher.session.put("kinect/map_odom", payload, attachment=attachment)
    wait_until(lambda: words in client._state.map_odom.parse_error)
    assert heard(talk, 9).seq == 9
    assert caplog.text.count("passed over") == 1


def test_what_another_run_of_the_service_said_is_forgotten() -> None:
    endpoint = find_free_endpoint()
    with PoseClient(connect=endpoint) as client:
        with running_fake_service(endpoint) as publisher:
            publisher.wait_for_reader()
            assert heard((publisher, client), 1).seq == 1
        wait_until(lambda: not client.is_alive)
        assert client._state.map_odom.item is None
