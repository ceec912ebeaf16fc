"""Commands reach the loop in order; who sent them gets the answer, or a reason."""

import pytest

from vo_service.control import CommandQueue
from vo_service.types.commands import (
    Command,
    CommandError,
    PauseCommand,
    ResetCommand,
    ResumeCommand,
)


def test_pending_commands_are_processed_in_order() -> None:
    inbox = CommandQueue()
    commands: list[Command] = [PauseCommand(), ResumeCommand(), ResetCommand()]
    for command in commands:
        inbox.submit(command)
    assert [ticket.command for ticket in inbox.take_pending()] == commands
    assert inbox.take_pending() == []


def test_a_closed_queue_refuses_pending_and_new_commands() -> None:
    inbox = CommandQueue()
    waiting = inbox.submit(PauseCommand())
    inbox.close()
    with pytest.raises(CommandError, match="ending"):
        waiting.result(1.0)
    with pytest.raises(CommandError, match="ending"):
        inbox.submit(PauseCommand())


def test_internal_commands_are_accepted_with_a_full_queue() -> None:
    inbox = CommandQueue(max_pending=1)
    inbox.submit(PauseCommand())
    inbox.submit_internal(ResetCommand())
    assert [ticket.command for ticket in inbox.take_pending()] == [PauseCommand(), ResetCommand()]
