"""Too many commands over real Zenoh are refused and counted, and never delay poses."""

import logging

import pytest

from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import (
    PoseSubscriber,
    answer_next_command,
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
from vo_service.types.commands import CommandError, PausedReply

pytestmark = pytest.mark.zenoh


def test_a_full_queue_refuses_the_next_command(free_port: int) -> None:
    with output_with_commands(free_port) as (_, command_queue, session):
        waiting = [session.get("kinect/command/pause", timeout=100) for _ in range(8)]
        wait_until(lambda: len(command_queue._pending) == 8)
        assert query_json(session, "kinect/command/pause")[0]["error"] == "busy"
        command_queue.close()
        assert {reply_json(reply)["error"] for one in waiting for reply in one} == {"not-possible"}


def test_commands_above_the_rate_are_refused_and_logged_once(
    free_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    with output_with_commands(free_port, per_second=1.0) as (_, command_queue, session):
        answer_next_command(command_queue, PausedReply(True))
        assert query_json(session, "kinect/command/pause") == [{"schema": 1, "paused": True}]
        codes = {query_json(session, "kinect/command/dance")[0]["error"] for _ in range(10)}
    assert codes == {"rate-limited"} or codes == {"rate-limited", "unknown-command"}
    lines = [line for line in caplog.messages if "more than 1 commands a second" in line]
    assert len(lines) == 1


def test_a_flood_of_commands_reaches_neither_the_loop_nor_delays_poses(free_port: int) -> None:
    with output_with_commands(free_port, per_second=10.0) as (output, command_queue, session):
        poses = PoseSubscriber(session, output)
        flood = [session.get("kinect/command/dance", timeout=100) for _ in range(5000)]
        assert poses.receives_all([make_update(seq) for seq in range(20)])
        codes = [reply_json(reply)["error"] for channel in flood for reply in channel]
        assert command_queue.take_pending() == []
        answer_next_command(command_queue, PausedReply(True))
        paused = {"schema": 1, "paused": True}
        wait_until(lambda: paused in query_json(session, "kinect/command/pause"))
    assert set(codes) <= {"unknown-command", "rate-limited"}
    assert 0 < len(codes) < 5000


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
