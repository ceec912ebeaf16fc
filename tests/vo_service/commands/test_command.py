"""`kinect-vo command` against a service that answers as it is told."""

import pytest

from tests.vo_service.client.published import free_endpoint, robot
from tests.vo_service.commands.command_line import call

pytestmark = pytest.mark.zenoh


def test_a_value_that_is_no_json_goes_out_as_text_however_deep(
    capfd: pytest.CaptureFixture[str],
) -> None:
    endpoint, deep = free_endpoint(), "[" * 3000
    with robot(endpoint) as service:
        sent = service.answers("command/reset", {"epoch": 2})
        outcome = call(capfd, "command", "reset", f"position_m={deep}", "--connect", endpoint)
    assert (outcome.out, outcome.err, outcome.code) == ('{"epoch": 2}\n', "", 0)
    assert sent == [{"position_m": deep}]


def test_an_answer_that_cannot_be_read_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    with robot(endpoint) as service:
        service.answers("command/pause", {"schema": 9})
        outcome = call(capfd, "command", "pause", "--connect", endpoint)
    assert outcome.err.startswith("kinect-vo: error: pause: the answer cannot be read: a message")
    assert (outcome.err.count("\n"), outcome.code) == (1, 1)
