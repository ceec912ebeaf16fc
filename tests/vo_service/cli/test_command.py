"""`kinect-vo command` against a service that answers as it is told."""

import pytest

from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.client.fake_service import find_free_endpoint, running_fake_service

pytestmark = pytest.mark.zenoh


def test_a_value_that_is_not_json_is_sent_as_text_at_any_depth(kinect_vo: KinectVo) -> None:
    endpoint, deep = find_free_endpoint(), "[" * 3000
    with running_fake_service(endpoint) as service:
        sent = service.answer_with("command/reset", {"epoch": 2})
        outcome = kinect_vo("command", "reset", f"position_m={deep}", "--connect", endpoint)
    assert (outcome.out, outcome.err, outcome.code) == ('{"epoch": 2}\n', "", 0)
    assert sent == [{"position_m": deep}]


def test_an_unreadable_reply_is_one_line(kinect_vo: KinectVo) -> None:
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as service:
        service.answer_with("command/pause", {"schema": 9})
        outcome = kinect_vo("command", "pause", "--connect", endpoint)
    assert_one_line(outcome, 1, "error: pause: the reply cannot be read: a message")
