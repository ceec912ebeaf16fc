"""When a loss of tracking is written: a second after it, and not again and again."""

from vo_service.outputs.recorder.loss_trigger import DELAY_S, MIN_INTERVAL_S, LossTrigger
from vo_service.types import TrackingState

TRACKING, LOST = TrackingState.TRACKING, TrackingState.LOST


def watch(*states: TrackingState, begin_s: float = 0.0) -> LossTrigger:
    """One that has seen these, 30 a second."""
    watch = LossTrigger()
    for number, state in enumerate(states):
        watch.update(state, begin_s + number / 30)
    return watch


def test_a_loss_is_due_once_and_a_second_later() -> None:
    lost = watch(TRACKING, LOST)
    assert not lost.is_due(0.9 * DELAY_S)
    assert lost.is_pending
    assert lost.is_due(1.1 * DELAY_S)
    assert not lost.is_due(1.2 * DELAY_S)
    assert not lost.is_pending


def test_staying_lost_or_beginning_lost_is_no_loss() -> None:
    assert not watch(LOST, LOST).is_pending
    still = watch(TRACKING, LOST)
    assert still.is_due(2.0)
    still.update(LOST, MIN_INTERVAL_S + 5.0)
    assert not still.is_pending


def test_tracking_that_comes_and_goes_is_written_once_in_a_while() -> None:
    flickering = watch(*[TRACKING, LOST] * 10)
    assert flickering.is_due(2.0)
    flickering.update(TRACKING, 3.0)
    flickering.update(LOST, 4.0)
    assert not flickering.is_pending
    flickering.update(TRACKING, MIN_INTERVAL_S + 5.0)
    flickering.update(LOST, MIN_INTERVAL_S + 6.0)
    assert flickering.is_pending


def test_a_degraded_pose_that_is_lost_counts() -> None:
    assert watch(TrackingState.DEGRADED, LOST).is_pending
