"""Too many commands over real Zenoh are refused and counted, and never delay poses."""

import logging

import pytest

from tests.vo_service.outputs.zenoh.query_helpers import (
    config,
    output_with_commands,
    query_json,
    reply_json,
)
from tests.waiting import wait_until
from vo_service.config_tables import CommandConfig
from vo_service.control import CommandQueue
from vo_service.outputs.zenoh.session import open_session
from vo_service.outputs.zenoh.session_endpoints import (
    CommandRateLimit,
    CommandServer,
    make_command_endpoint,
)
from vo_service.types.commands import CommandError

pytestmark = pytest.mark.zenoh


def test_a_full_queue_refuses_the_next_command(free_port: int) -> None:
    with output_with_commands(free_port) as (_, command_queue, session):
        waiting = [session.get("kinect/command/pause", timeout=100) for _ in range(8)]
        wait_until(lambda: len(command_queue._pending) == 8)
        assert query_json(session, "kinect/command/pause")[0]["error"] == "busy"
        command_queue.close()
        assert {reply_json(reply)["error"] for one in waiting for reply in one} == {"not-possible"}


def test_the_rate_limit_reports_the_number_of_refusals(caplog: pytest.LogCaptureFixture) -> None:
    now_s = [0.0]
    limit = CommandRateLimit(2.0, lambda: now_s[0])
    for _ in range(2):
        limit.check()
    for _ in range(61):
        with pytest.raises(CommandError, match="more than 2 commands a second"):
            limit.check()
        now_s[0] += 0.001
    now_s[0] += 60.0
    for _ in range(2):
        limit.check()
    with pytest.raises(CommandError):
        limit.check()
    log_args = [record.args for record in caplog.records if record.levelno == logging.WARNING]
    assert [args[1] for args in log_args if isinstance(args, tuple)] == [1, 61]


def test_the_configuration_sets_the_rate(free_port: int) -> None:
    commands = make_command_endpoint(CommandConfig(per_second=1.0), CommandQueue())
    assert isinstance(commands, CommandServer)
    with open_session(config(free_port)) as session:
        commands.declare(session, "kinect")
        codes = [query_json(session, "kinect/command/dance")[0]["error"] for _ in range(9)]
        commands.configure(CommandConfig(per_second=1000.0))
        wait_until(
            lambda: query_json(session, "kinect/command/dance")[0]["error"] == "unknown-command"
        )
        later = {query_json(session, "kinect/command/dance")[0]["error"] for _ in range(9)}
    commands.close()
    assert "rate-limited" in codes
    assert later == {"unknown-command"}
