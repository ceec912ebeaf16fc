"""Processor time by stage, one frame at a time."""

import pytest

from vo_service.odometry import stage_timers
from vo_service.odometry.stage_timers import CpuStageTimer


class TickingClock:
    """A module `time` whose thread clock moves on by a millisecond a look."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def thread_time(self) -> float:
        self._now_s += 1e-3
        return self._now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> CpuStageTimer:
    monkeypatch.setattr(stage_timers, "time", TickingClock())
    return CpuStageTimer()


def test_repeated_stages_add_up_within_a_frame(clock: CpuStageTimer) -> None:
    for name in ("surf", "match", "match"):
        with clock.stage(name):
            pass
    assert clock.take_stage_ms() == pytest.approx({"surf": 1.0, "match": 2.0})


def test_each_frame_starts_at_zero(clock: CpuStageTimer) -> None:
    with clock.stage("surf"):
        pass
    clock.take_stage_ms()
    assert clock.take_stage_ms() == {}


def test_a_failed_stage_is_timed_too(clock: CpuStageTimer) -> None:
    with pytest.raises(ValueError, match="no"), clock.stage("surf"):
        raise ValueError("no")
    assert clock.take_stage_ms() == pytest.approx({"surf": 1.0})
