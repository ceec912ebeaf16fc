"""Keyframes are made and values learned after the estimate, if the caller wants so."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.vo_service.odometry.direct.swinging_camera import DELAY_S, READOUT_S, swinging_frames
from vo_service.odometry.registry import make_odometry
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import DeferredWork


class CountingWork(DeferredWork):
    """Deferred work that is counted."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: list[int] = []

    def add(self, work: Callable[[], None]) -> None:
        super().add(work)
        self.counts[-1] += 1


@pytest.fixture(scope="module")
def deferred() -> tuple[list[Estimate], list[int]]:
    """The estimates of a swinging camera, and the number of works that each deferred."""
    work = CountingWork()
    odometry, estimates = make_odometry("direct", deferred=work), []
    for frame in swinging_frames(READOUT_S, DELAY_S):
        work.counts.append(0)
        estimates.append(odometry.estimate(frame))
        work.run()
    return estimates, work.counts


def test_work_done_later_changes_no_estimate(deferred: tuple[list[Estimate], list[int]]) -> None:
    """Not during the search for the timing, and not with learned values and new keyframes."""
    odometry = make_odometry("direct")
    at_once = map(odometry.estimate, swinging_frames(READOUT_S, DELAY_S))
    for later, now in zip(deferred[0], at_once, strict=True):
        assert np.array_equal(later.T_world_camera, now.T_world_camera)
        assert np.array_equal(later.covariance, now.covariance)
        assert later.timing == now.timing
        assert later.focal_length == now.focal_length
        assert later.is_next_reference == now.is_next_reference


def test_learning_and_keyframes_are_deferred(deferred: tuple[list[Estimate], list[int]]) -> None:
    estimates, counts = deferred
    new_keyframes = [estimate.is_next_reference for estimate in estimates]
    assert counts[-1] >= 1
    assert max(np.array(counts)[new_keyframes]) == 2
    assert max(counts) == 2
