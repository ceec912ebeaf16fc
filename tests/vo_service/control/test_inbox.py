"""Commands reach the loop in order; who sent them gets the answer, or a reason."""

import pytest

from vo_service.control.inbox import Inbox
from vo_service.types import Command, CommandError, ErrorCode, Pause, Reset, Resume


def test_the_loop_takes_all_that_wait_in_order() -> None:
    inbox: Inbox[Command] = Inbox()
    commands: list[Command] = [Pause(), Resume(), Reset()]
    for command in commands:
        inbox.submit(command)
    assert [ticket.command for ticket in inbox.take()] == commands
    assert inbox.take() == []


def test_an_answer_reaches_who_sent_the_command() -> None:
    inbox: Inbox[Command] = Inbox()
    ticket = inbox.submit(Reset())
    inbox.take()[0].done({"epoch": 3})
    assert ticket.wait(1.0) == {"epoch": 3}


def test_an_error_reaches_who_sent_the_command() -> None:
    inbox: Inbox[Command] = Inbox()
    ticket = inbox.submit(Reset())
    inbox.take()[0].failed(CommandError(ErrorCode.NOT_POSSIBLE, "no motor"))
    with pytest.raises(CommandError, match="no motor"):
        ticket.wait(1.0)


def test_a_loop_that_does_not_answer_is_not_waited_for() -> None:
    inbox: Inbox[Command] = Inbox()
    with pytest.raises(CommandError, match="no answer") as raised:
        inbox.submit(Reset()).wait(0.01)
    assert raised.value.code is ErrorCode.TIMED_OUT


def test_more_than_a_few_are_refused() -> None:
    inbox: Inbox[Command] = Inbox(most=2)
    inbox.submit(Pause())
    inbox.submit(Pause())
    with pytest.raises(CommandError) as raised:
        inbox.submit(Pause())
    assert raised.value.code is ErrorCode.BUSY


def test_a_closed_inbox_refuses_what_waits_and_what_comes() -> None:
    inbox: Inbox[Command] = Inbox()
    waiting = inbox.submit(Pause())
    inbox.close()
    with pytest.raises(CommandError, match="ending"):
        waiting.wait(1.0)
    with pytest.raises(CommandError, match="ending"):
        inbox.submit(Pause())


def test_the_programs_own_orders_are_taken_however_many_wait() -> None:
    inbox: Inbox[Command] = Inbox(most=1)
    inbox.submit(Pause())
    inbox.order(Reset())
    assert [ticket.command for ticket in inbox.take()] == [Pause(), Reset()]
