"""The viewer is paused while the odometry is late, and runs again later."""

import logging
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vo_service.fakes import FakeClock
from vo_service.config_tables import LoadConfig
from vo_service.control import MAX_PAUSE_S, LoadShedder

INTERVAL_S = 1 / 32  # a number that adds up without rounding


class SimulatedMachine:
    """Sends frames to a load shedder and its viewer; frames during a busy loop are dropped."""

    def __init__(self) -> None:
        self.clock = FakeClock(0.0)
        self.load_shedder = LoadShedder([self], self.clock)
        self.is_paused = False
        self.dropped = 0
        self.changes_s: list[float] = []
        self._frame = 0

    def set_paused(self, is_paused: bool) -> None:
        """As a viewer."""
        if is_paused != self.is_paused:
            self.changes_s.append(self.clock.now_s)
        self.is_paused = is_paused

    def run(self, seconds: float, load: Callable[[bool], float]) -> None:
        """Process frames; `load` is a frame's time in intervals, given whether it is paused."""
        end_s = self.clock.now_s + seconds
        while self.clock.now_s < end_s:
            due = int(self.clock.now_s / INTERVAL_S)
            self.dropped += max(0, due - self._frame - 1)
            self._frame = max(due, self._frame + 1)
            self.clock.now_s = max(self.clock.now_s, self._frame * INTERVAL_S)
            busy_s = load(self.is_paused) * INTERVAL_S
            self.clock.now_s += busy_s
            self.load_shedder.add_frame(busy_s, INTERVAL_S, self.dropped)


def always(load: float) -> Callable[[bool], float]:
    return lambda is_paused: load


def test_at_low_load_nothing_is_paused() -> None:
    machine = SimulatedMachine()
    machine.run(60.0, always(0.75))
    assert (machine.changes_s, machine.load_shedder.warning) == ([], "")


def test_the_viewer_is_paused_before_a_frame_is_dropped() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, lambda is_paused: 0.65 if is_paused else 0.95)
    assert machine.is_paused
    assert machine.dropped == 0
    assert machine.load_shedder.warning == "the machine is too slow: the viewer is paused"


def test_dropped_frames_pause_within_two_seconds() -> None:
    machine = SimulatedMachine()
    machine.run(10.0, always(0.1))
    machine.run(2.0, always(2.0))
    assert machine.is_paused


@pytest.mark.parametrize("hiccup_s", [0.2, 1.0, 5.0])
def test_a_single_slow_frame_changes_nothing(hiccup_s: float) -> None:
    machine = SimulatedMachine()
    machine.run(10.0, always(0.6))
    machine.run(hiccup_s, always(hiccup_s / INTERVAL_S))
    machine.run(10.0, always(0.6))
    assert machine.dropped > 0
    assert machine.changes_s == []


def test_a_slow_start_changes_nothing() -> None:
    machine = SimulatedMachine()
    machine.run(2.0, always(4.0))
    machine.run(10.0, always(0.5))
    assert machine.changes_s == []


def test_a_time_without_frames_does_not_count_as_low_load() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, always(2.0))
    machine.clock.now_s += 3600.0
    machine.run(5.0, always(0.1))
    assert machine.is_paused


def test_pauses_grow_while_the_load_returns_with_the_viewer() -> None:
    machine = SimulatedMachine()
    machine.run(5000.0, lambda is_paused: 0.3 if is_paused else 1.2)
    pauses_s = [end - begin for begin, end in pairwise(machine.changes_s)][::2]
    assert len(pauses_s) > 6
    assert all(b > 1.5 * a or b > MAX_PAUSE_S for a, b in pairwise(pauses_s))
    assert max(pauses_s) < 1.1 * MAX_PAUSE_S


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(st.floats(1.0, 30.0), st.floats(0.0, 3.0)), max_size=5),
    st.floats(0.0, 0.55),
)
def test_the_viewer_runs_again_when_the_load_drops(
    history: list[tuple[float, float]], low_load: float
) -> None:
    machine = SimulatedMachine()
    for seconds, load in history:
        machine.run(seconds, always(load))
    machine.run(200.0, always(low_load))
    assert not machine.is_paused


def test_each_change_is_one_log_line(caplog: pytest.LogCaptureFixture) -> None:
    machine = SimulatedMachine()
    with caplog.at_level(logging.WARNING):
        machine.run(20.0, always(2.0))
        machine.run(120.0, always(0.1))
    assert caplog.messages == [
        "the machine is too slow: the viewer is paused",
        "the load is low again: the viewer draws",
    ]


def test_switched_off_it_pauses_nothing_and_a_paused_viewer_runs_again() -> None:
    machine = SimulatedMachine()
    machine.run(20.0, always(2.0))
    machine.load_shedder.configure(LoadConfig(adapt=False))
    machine.run(20.0, always(2.0))
    assert len(machine.changes_s) == 2  # paused, and resumed by the setting
    assert not machine.is_paused
