"""The trigger fires one second after a loss, and not again for a while."""

from vo_service.outputs.recorder.loss_trigger import DELAY_S, MIN_INTERVAL_S, LossTrigger
from vo_service.types.odometry_update import TrackingState

TRACKING, LOST = TrackingState.TRACKING, TrackingState.LOST


def make_trigger(*states: TrackingState, begin_s: float = 0.0) -> LossTrigger:
    """Make a trigger that has received these states, 30 a second."""
    trigger = LossTrigger()
    for number, state in enumerate(states):
        trigger.update(state, begin_s + number / 30)
    return trigger


def test_a_loss_triggers_once_a_second_later() -> None:
    trigger = make_trigger(TRACKING, LOST)
    assert not trigger.is_due(0.9 * DELAY_S)
    assert trigger.is_pending
    assert trigger.is_due(1.1 * DELAY_S)
    assert not trigger.is_due(1.2 * DELAY_S)
    assert not trigger.is_pending


def test_staying_lost_or_starting_lost_is_no_loss() -> None:
    assert not make_trigger(LOST, LOST).is_pending
    trigger = make_trigger(TRACKING, LOST)
    assert trigger.is_due(2.0)
    trigger.update(LOST, MIN_INTERVAL_S + 5.0)
    assert not trigger.is_pending


def test_repeated_losses_trigger_at_a_limited_rate() -> None:
    trigger = make_trigger(*[TRACKING, LOST] * 10)
    assert trigger.is_due(2.0)
    trigger.update(TRACKING, 3.0)
    trigger.update(LOST, 4.0)
    assert not trigger.is_pending
    trigger.update(TRACKING, MIN_INTERVAL_S + 5.0)
    trigger.update(LOST, MIN_INTERVAL_S + 6.0)
    assert trigger.is_pending


def test_a_loss_after_a_degraded_pose_triggers() -> None:
    assert make_trigger(TrackingState.DEGRADED, LOST).is_pending
