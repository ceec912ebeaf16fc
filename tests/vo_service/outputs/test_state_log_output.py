"""Each change of state is logged once."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.vo_service.fakes import FakeClock
from tests.vo_service.outputs.sample_updates import STATUS
from vo_service.outputs import state_log
from vo_service.outputs.state_log import StateLogOutput
from vo_service.types.odometry_update import TrackingState

TRACKING, DEGRADED, LOST, NO_CAMERA = (
    *(TrackingState.TRACKING, TrackingState.DEGRADED),
    *(TrackingState.LOST, TrackingState.NO_CAMERA),
)
StateAndReason = tuple[TrackingState, str]
START: StateAndReason = (NO_CAMERA, "camera not opened yet")


@pytest.fixture
def log(caplog: pytest.LogCaptureFixture) -> Callable[..., list[str]]:
    """Return the log lines of a sequence of states."""

    def run(*states: StateAndReason) -> list[str]:
        output = StateLogOutput()
        with caplog.at_level("INFO"):
            for state, reason in states:
                output.on_status(replace(STATUS, state=state, reason=reason))
        return [f"{record.levelname} {record.getMessage()}" for record in caplog.records]

    return run


def test_the_initial_state_is_not_logged(log: Callable[..., list[str]]) -> None:
    assert log(START, START) == []


def test_a_camera_that_opens_slowly_is_logged_once_and_then_with_the_time(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = FakeClock()
    monkeypatch.setattr(state_log, "time", clock)
    output = StateLogOutput()
    opening = replace(STATUS, state=NO_CAMERA, reason="starting: preparing its room")
    with caplog.at_level("INFO"):
        for _ in range(8):
            output.on_status(opening)
            clock.now_s += 0.5
        output.on_status(replace(STATUS, state=TRACKING, reason=""))
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("INFO", "no_camera: starting: preparing its room ..."),
        ("INFO", "tracking (after 4.0 s without a camera)"),
    ]


def test_loss_and_recovery_are_warnings(log: Callable[..., list[str]]) -> None:
    assert log(START, (TRACKING, ""), (LOST, "lens covered"), (TRACKING, "")) == [
        "INFO tracking",
        "WARNING lost: lens covered",
        "WARNING tracking",
    ]


def test_a_constant_state_is_logged_once(log: Callable[..., list[str]]) -> None:
    states = [(DEGRADED, f"only {n} of 80 matches agree") for n in range(20, 25)]
    assert log((TRACKING, ""), *states) == ["WARNING degraded: only 20 of 80 matches agree"]


def test_a_missing_camera_is_logged_at_the_start_and_when_the_cause_changes(
    log: Callable[..., list[str]],
) -> None:
    missing, refused = (NO_CAMERA, "no Kinect found"), (NO_CAMERA, "not allowed to open it")
    assert log(START, missing, missing, refused, refused) == [
        "WARNING no_camera: no Kinect found",
        "WARNING no_camera: not allowed to open it",
    ]


def test_an_opening_camera_is_not_a_fault_and_ends_none(
    log: Callable[..., list[str]],
) -> None:
    opening, absent, starting = ((NO_CAMERA, why) for why in ("opening", "absent", "starting"))
    assert log(opening, starting, (TRACKING, ""), absent, starting, (TRACKING, "")) == [
        "INFO no_camera: starting",
        "INFO tracking",
        "WARNING no_camera: absent",
        "INFO no_camera: starting",
        "WARNING tracking",
    ]


def test_a_fault_of_a_streaming_camera_is_logged_once_per_state(
    log: Callable[..., list[str]],
) -> None:
    torn, more = (TRACKING, "31 of 60 frames torn"), (TRACKING, "40 of 60 frames torn")
    assert log(START, (TRACKING, ""), torn, more, (TRACKING, ""), torn, (LOST, "dark"), torn) == [
        "INFO tracking",
        "WARNING tracking: 31 of 60 frames torn",
        "WARNING lost: dark",
        "WARNING tracking: 31 of 60 frames torn",
    ]
