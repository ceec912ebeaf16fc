"""The client's map->odom transform."""

import numpy as np
import pytest

from tests.vo_service.client.fake_service import (
    BLOCK,
    FakeService,
    find_free_endpoint,
    running_fake_service,
)
from tests.waiting import wait_until
from vo_service import CommandRefused, MapOdom, PoseClient

pytestmark = pytest.mark.zenoh


def receive_map_odom(service: FakeService, client: PoseClient, seq: int) -> MapOdom:
    """Publish a transform and return what the client gives out."""
    service.publish_map_odom(
        2.0, seq=seq, epoch=1, is_localized=False, map_keyframes=7, loop_closures=2
    )

    def is_there() -> bool:
        received = client._state.map_odom.item
        return received is not None and received.seq == seq

    wait_until(is_there)
    return client.map_odom()


def test_a_map_odom_has_all_fields_of_the_message(service: FakeService, client: PoseClient) -> None:
    received = receive_map_odom(service, client, 7)
    assert (received.stamp_s, received.frame_id, received.child_frame_id) == (12.5, "map", "odom")
    assert (received.seq, received.epoch, received.is_localized) == (7, 1, False)
    assert (received.map_keyframes, received.loop_closures) == (7, 2)
    np.testing.assert_allclose(received.T_map_odom[:3, 3], [0.0, 2.0, 0.0])
    assert 0 <= received.age_s < 20


def test_a_service_without_a_map_raises_an_error() -> None:
    with running_fake_service() as publisher:
        publisher.answer_with(
            "map_odom", {"error": "not-possible", "message": "there is no map yet"}
        )
        with PoseClient(connect=publisher.endpoint) as client:
            publisher.wait_for_reader()
            with pytest.raises(CommandRefused, match="there is no map yet"):
                client.map_odom(timeout_s=100)


def test_an_unreadable_message_is_skipped_and_the_next_one_read(
    service: FakeService, client: PoseClient, caplog: pytest.LogCaptureFixture
) -> None:
    attachment = b'{"schema": 1, "seq": 1}'
    service.session.put("kinect/map_odom", b"", attachment=attachment, congestion_control=BLOCK)
    message = "without epoch, is_localized, loop_closures, map_keyframes"
    wait_until(lambda: message in client._state.map_odom.parse_error)
    assert receive_map_odom(service, client, 9).seq == 9
    assert caplog.text.count("ignored a message") == 1


def test_a_transform_of_an_earlier_run_is_dropped() -> None:
    endpoint = find_free_endpoint()
    with PoseClient(connect=endpoint) as client:
        with running_fake_service(endpoint) as publisher:
            publisher.wait_for_reader()
            assert receive_map_odom(publisher, client, 1).seq == 1
        wait_until(lambda: not client.is_alive)
        assert client._state.map_odom.item is None
