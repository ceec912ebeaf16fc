"""What is reduced under load, in which order, and when it is restored."""

import logging
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vo_service.fakes import FakeClock
from tests.vo_service.load_shedding.simulated_machine import (
    INTERVAL_S,
    FakeOdometry,
    FakeViewer,
    SimulatedMachine,
    affine_cost,
    proportional_cost,
)
from vo_service.load_shedding import (
    MAX_LOAD,
    MAX_RESTORE_WAIT_S,
    EffortLevel,
    FrameCost,
    NullLoadShedder,
    effort_levels,
)

FULL = EffortLevel(is_viewer_paused=False, feature_count=1000)
LEAST = EffortLevel(is_viewer_paused=True, feature_count=300)
shares = st.floats(0.0, 3.0)


def test_the_viewer_is_paused_first_then_features_are_reduced() -> None:
    assert effort_levels(1000, 300, has_viewer=True) == [
        FULL,
        *(EffortLevel(True, feature_count) for feature_count in (1000, 700, 500, 300)),
    ]


@given(st.integers(50, 5000), st.integers(50, 5000), st.booleans())
def test_features_are_reduced_down_to_the_minimum(full: int, least: int, viewer: bool) -> None:
    counts = [effort.feature_count for effort in effort_levels(full, least, viewer)]
    assert counts[0] == full
    assert counts[-1] == min(full, least)
    assert counts == sorted(counts, reverse=True)


def test_at_low_load_nothing_is_reduced() -> None:
    machine = SimulatedMachine()
    machine.run(60.0, proportional_cost(0.75))
    assert machine.changes == []
    assert machine.load_shedder.warning == ""


def test_the_viewer_is_paused_before_a_frame_is_dropped() -> None:
    machine = SimulatedMachine()
    machine.run(20.0, affine_cost(fixed=0.3, features=0.3, viewer=0.3))
    assert machine.load_shedder.effort == EffortLevel(True, 1000)
    assert machine.viewers[0].is_paused
    assert machine.dropped == 0


def test_features_are_reduced_if_pausing_the_viewer_does_not_suffice() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, affine_cost(fixed=0.5, features=0.5, viewer=0.1))
    assert machine.odometry.feature_count == 500
    assert (
        machine.load_shedder.warning
        == "the machine is too slow: the viewer is paused, 500 features"
    )


def test_without_a_viewer_features_are_reduced_at_once() -> None:
    machine = SimulatedMachine(viewers=())
    machine.run(10.0, affine_cost(fixed=0.1, features=0.8, viewer=0.0))
    assert machine.load_shedder.warning == "the machine is too slow: 700 features"


def test_consecutive_dropped_frames_reduce_at_once() -> None:
    machine = SimulatedMachine()
    machine.run(10.0, proportional_cost(0.1))
    machine.run(1.0, proportional_cost(2.0))
    assert machine.changes[0][0] - 10.0 < 0.5


def test_occasional_dropped_frames_count_as_overload() -> None:
    machine = SimulatedMachine()
    for number in range(320):
        machine.clock.now_s += INTERVAL_S
        busy_s = 0.4 * INTERVAL_S
        machine.load_shedder.add_frame(FrameCost(busy_s, busy_s, INTERVAL_S, dropped=number // 16))
    assert machine.load_shedder.effort != FULL


def test_a_process_without_cpu_time_is_distinguished_from_a_slow_machine() -> None:
    machine = SimulatedMachine()
    for _ in range(320):
        machine.clock.now_s += INTERVAL_S
        machine.load_shedder.add_frame(
            FrameCost(0.95 * INTERVAL_S, 0.2 * INTERVAL_S, INTERVAL_S, 0)
        )
    assert machine.load_shedder.warning.startswith("the odometry gets too little CPU time: ")


def test_every_third_frame_delayed_by_a_quota_counts_as_overload() -> None:
    machine = SimulatedMachine()
    for number in range(600):
        busy_s = 1.9 * INTERVAL_S if number % 3 == 0 else 0.4 * INTERVAL_S
        machine.clock.now_s += INTERVAL_S
        machine.load_shedder.add_frame(FrameCost(busy_s, 0.3 * INTERVAL_S, INTERVAL_S, 0))
    assert machine.load_shedder.effort != FULL


@pytest.mark.parametrize("hiccup_s", [0.2, 1.0, 5.0])
def test_a_single_slow_frame_changes_nothing(hiccup_s: float) -> None:
    machine = SimulatedMachine()
    machine.run(10.0, proportional_cost(0.6))
    machine.run(hiccup_s, lambda now_s, effort: hiccup_s)
    machine.run(10.0, proportional_cost(0.6))
    assert machine.dropped > 0
    assert machine.changes == []


def test_a_slow_start_changes_nothing() -> None:
    machine = SimulatedMachine()
    machine.run(2.0, proportional_cost(4.0))
    machine.run(10.0, proportional_cost(0.5))
    assert machine.changes == []


def test_between_the_thresholds_nothing_changes() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, proportional_cost(2.0))
    machine.run(300.0, proportional_cost(0.7))
    assert machine.load_shedder.effort == LEAST


def test_a_pause_does_not_count_as_low_load() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, proportional_cost(2.0))
    machine.clock.now_s += 3600.0
    machine.run(5.0, proportional_cost(0.1))
    assert machine.load_shedder.effort == LEAST


def test_each_step_is_one_log_line(caplog: pytest.LogCaptureFixture) -> None:
    machine = SimulatedMachine()
    with caplog.at_level(logging.WARNING):
        machine.run(20.0, proportional_cost(2.0))
        machine.run(120.0, proportional_cost(0.1))
    assert len(caplog.messages) == len(machine.changes) == 8
    assert caplog.messages[3:5] == [
        "the machine is too slow: the viewer is paused, 300 features",
        "the load is low again; still: the viewer is paused, 500 features",
    ]
    assert caplog.messages[-1] == "the load is low again"


def test_release_restores_everything() -> None:
    machine = SimulatedMachine()
    machine.run(30.0, proportional_cost(2.0))
    machine.load_shedder.restore_all()
    assert machine.load_shedder.effort == FULL
    assert (machine.odometry, machine.viewers) == (FakeOdometry(1000), (FakeViewer(False),))


def test_null_load_shedding_changes_nothing() -> None:
    effort = NullLoadShedder()
    effort.add_frame(FrameCost(9.0, 9.0, INTERVAL_S, 100))
    effort.restore_all()
    assert effort.warning == ""


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(fixed=st.floats(0.0, 1.5), features=st.floats(0.0, 1.5), viewer=st.floats(0.0, 0.2))
def test_a_constant_load_settles(fixed: float, features: float, viewer: float) -> None:
    machine = SimulatedMachine()
    machine.run(300.0, affine_cost(fixed, features, viewer))
    late_changes_s = [at_s for at_s, effort in machine.changes if at_s > 60.0]
    # Each failed restore doubles the wait before the next one.
    assert len(late_changes_s) <= 6


@settings(max_examples=15, deadline=None)
@given(st.floats(1.0, 4.0), st.sampled_from([100, 300, 1000, 2000]))
def test_a_permanent_overload_ends_at_the_minimum(load: float, least: int) -> None:
    machine = SimulatedMachine(min_features=least)
    machine.run(60.0, proportional_cost(load))
    assert machine.load_shedder.effort == EffortLevel(True, min(1000, least))


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.floats(1.0, 30.0), shares), max_size=5), st.floats(0.0, 0.55))
def test_everything_is_restored_when_the_load_drops(
    history: list[tuple[float, float]], low_load: float
) -> None:
    machine = SimulatedMachine()
    for seconds, load in history:
        machine.run(seconds, proportional_cost(load))
        assert 300 <= machine.odometry.feature_count <= 1000
    machine.run(100.0, proportional_cost(low_load))
    assert machine.load_shedder.effort == FULL
    assert not machine.viewers[0].is_paused


@pytest.mark.slow
def test_waits_grow_with_every_failed_restore_up_to_a_limit() -> None:
    machine = SimulatedMachine(viewers=(), min_features=700)
    machine.run(5000.0, lambda now_s, e: (1.2 if e.feature_count == 1000 else 0.3) * INTERVAL_S)
    restored_s = [at_s for at_s, effort in machine.changes if effort.feature_count == 1000]
    waits_s = [later - before for before, later in pairwise(restored_s)]
    assert len(waits_s) > 6
    assert all(
        1.5 * before < later or later > MAX_RESTORE_WAIT_S for before, later in pairwise(waits_s)
    )
    assert max(waits_s) < 1.1 * MAX_RESTORE_WAIT_S


def test_a_clock_that_starts_at_zero_is_accepted() -> None:
    machine = SimulatedMachine(clock=FakeClock(0.0))
    machine.run(8.0, proportional_cost(MAX_LOAD + 0.1))
    machine.run(20.0, proportional_cost(0.1))
    assert machine.load_shedder.effort != LEAST
