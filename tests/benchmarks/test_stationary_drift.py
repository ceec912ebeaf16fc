"""Drift of a stationary camera's pose."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.stationary_drift import DriftResult, format_row, measure_drift
from drivers.camera import RgbdFrame
from drivers.core import PluginGroup
from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.fakes import make_frame
from vo_service.types import Estimate


class DriftingOdometry:
    """An odometry that drifts by a millimeter and a tenth of a degree per frame; one is lost."""

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Return the drifted pose."""
        turn = so3_exp([0.0, 0.0, np.radians(0.1 * frame.seq)])
        T = rigid_transform(turn, [0.5 + 0.001 * frame.seq, 0.0, 0.0])
        return Estimate(frame.seq != 1, "", T, np.eye(4), np.eye(6))


@pytest.fixture
def minutes(monkeypatch: pytest.MonkeyPatch) -> list[DriftResult]:
    monkeypatch.setattr(
        PluginGroup, "__getitem__", lambda methods, name: lambda *_: DriftingOdometry()
    )
    frames = (replace(make_frame(0), seq=seq) for seq in range(6))
    return list(measure_drift("creeping", frames, 3))


def test_each_minute_is_reported_from_the_first_pose_on(minutes: list[DriftResult]) -> None:
    assert [(stood.frames, stood.lost) for stood in minutes] == [(3, 1), (6, 1)]
    np.testing.assert_allclose(minutes[0].max_error, [0.002, 0.2], atol=1e-9)
    np.testing.assert_allclose(minutes[1].max_error, [0.005, 0.5], atol=1e-9)
    squares = np.mean([0, 4, 9, 16, 25])
    np.testing.assert_allclose(minutes[1].rms, np.sqrt(squares) * np.array([0.001, 0.1]), atol=1e-9)


def test_drift_is_from_the_first_minute_to_the_last(minutes: list[DriftResult]) -> None:
    np.testing.assert_allclose(minutes[0].drift, [0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(minutes[1].drift, [0.003, 0.3], atol=1e-9)


def test_a_line_is_in_millimeters_and_degrees(minutes: list[DriftResult]) -> None:
    line = format_row(2, minutes[1])
    assert line.split()[:7] == ["2", "6", "1", "5.000", "mm", "0.5000", "deg"]
