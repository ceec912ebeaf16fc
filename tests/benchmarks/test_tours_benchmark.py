"""Long tours: rendering on demand, evaluation by the truth, and the cache of results."""

import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import tours
from benchmarks.__main__ import main
from benchmarks.rendered_sequences import PREFETCH_COUNT, prefetch
from benchmarks.tours import (
    LoopClosureRunner,
    TourRecord,
    compute_true_poses,
    make_tour_config,
    measure,
    render_frames,
    run_tour,
    save_plot,
)
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, Trajectory, inverse
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.renderer import make_renderer
from tests.vo_service.fakes import make_frame
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate

TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)
LOST = 3


def tiny_tour(seed: int, seconds: float, twins: bool) -> SyntheticConfig:
    return replace(make_tour_config(seed, seconds, twins), camera=TINY, texel_m=0.05)


@dataclass
class ScriptedRunner(LoopClosureRunner):
    """A runner with scripted poses, optimized poses and loop closures."""

    poses: Array
    offset_m: float = 0.0
    closures: tuple[Array, Array] = (np.empty((0, 2)), np.empty((0, 4, 4)))

    def process(self, frame: RgbdFrame) -> OdometryUpdate:
        """Return an update with the scripted pose; none at frame LOST."""
        self.cpu_ms = 1.0, 0.5
        is_ok = frame.seq != LOST
        estimate = Estimate(is_ok, "", self.poses[frame.seq], np.eye(4), np.eye(6))
        return replace(make_update(frame.seq), estimate=estimate)

    @property
    def optimized(self) -> Trajectory:
        """Shift every other pose up."""
        poses = self.poses.copy()
        poses[::2, 2, 3] += self.offset_m
        return Trajectory(np.arange(len(poses)) / 30.0, poses)

    def loop_closures(self) -> tuple[Array, Array]:
        """Return the scripted loop closures."""
        return self.closures


def frames(count: int) -> list[RgbdFrame]:
    return [replace(make_frame(0), seq=n, stamp_s=n / 30.0) for n in range(count)]


def follow(runner: ScriptedRunner, truth: Array) -> TourRecord:
    return run_tour(runner, frames(len(truth)), truth, lambda done, total: None)


@pytest.fixture(scope="module")
def truth() -> Array:
    return compute_true_poses(tiny_tour(1, 4.0, twins=False))


def test_prefetched_items_are_in_order_and_few() -> None:
    begun, taken = [], 0
    lock = threading.Lock()

    def make(number: int) -> int:
        with lock:
            begun.append(number)
        return number

    for number in prefetch(make, 40):
        assert number == taken
        taken += 1
        with lock:
            assert len(begun) <= taken + PREFETCH_COUNT
    assert taken == 40


@pytest.mark.slow
def test_a_tour_has_the_frames_of_the_virtual_kinect() -> None:
    config = tiny_tour(1, 0.2, twins=False)
    streamed, renderer = list(render_frames(config)), make_renderer(config, 1)
    assert [each.stamp_s for each in streamed] == [round(n / 30, 6) for n in range(6)]
    np.testing.assert_array_equal(streamed[4].color_bgr, renderer.render(4).color_bgr)
    np.testing.assert_array_equal(streamed[4].depth_raw, renderer.render(4).depth_raw)
    assert (streamed[0].readout_s, streamed[0].skew_s) == (0.02, 0.01)


def test_errors_are_those_of_the_estimated_and_of_the_optimized_poses(truth: Array) -> None:
    T_start_room = inverse(truth[0])
    record = follow(ScriptedRunner(T_start_room @ truth, offset_m=0.02), truth)
    frames, cover, epochs, gross, ate_m, optimized_m, loops, wrong, *_, memory = measure(record)
    assert (frames, epochs, gross, loops, wrong) == (120, 0, 0, 0, 0)
    assert cover == pytest.approx(100 * 119 / 120)
    assert ate_m == pytest.approx(0.0, abs=1e-9)
    assert optimized_m == pytest.approx(0.01, rel=0.1)
    assert min(map(float, str(memory).split())) > 10.0


def test_an_unreported_jump_is_a_gross_error(truth: Array) -> None:
    jumping = truth.copy()
    jumping[60:, 0, 3] += 0.06
    assert measure(follow(ScriptedRunner(jumping), truth))[3] == 1


def test_a_loop_closure_with_an_error_above_five_centimeters_is_wrong(truth: Array) -> None:
    right, wrong = (inverse(truth[10]) @ truth[100] for _ in range(2))
    right[0, 3] += 0.04
    wrong[0, 3] += 0.06
    loops = np.tile([10 / 30, 100 / 30], (3, 1)), np.array([right, wrong, right])
    assert measure(follow(ScriptedRunner(truth, closures=loops), truth))[6:8] == (3, 1)


def test_a_record_can_be_loaded_and_plotted(truth: Array, tmp_path: Path) -> None:
    record = follow(ScriptedRunner(truth, 0.02, (np.array([[0.1, 0.2]]), truth[5:6])), truth)
    record.save(tmp_path / "tour.npz")
    again = TourRecord.load(tmp_path / "tour.npz")
    assert measure(again) == measure(record)
    np.testing.assert_array_equal(again.T_keyframe_camera[0], truth[5])
    assert np.flatnonzero(~again.has_pose).tolist() == [LOST]
    save_plot({"tour": again}, tmp_path / "tour.png")
    assert (tmp_path / "tour.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_finished_tour_is_not_run_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tours, "make_tour_config", tiny_tour)
    poses = compute_true_poses(tiny_tour(1, 0.2, twins=False))
    monkeypatch.setattr(tours, "LoopClosureRunner", lambda method: ScriptedRunner(poses))
    folder = tmp_path / "new"
    arguments = ["tours", str(folder), "--seconds", "0.2", "--seeds", "1", "2", "--method", "icp"]
    assert main(arguments) == 0
    first = capsys.readouterr().out
    assert [line.split()[:2] for line in first.splitlines()[1:]] == [
        ["tour-0.2s-1-icp", "6"],
        ["tour-0.2s-2-icp", "6"],
    ]
    assert (folder / "tour-0.2s-2-icp.npz").exists()
    monkeypatch.setattr(tours, "render_frames", lambda config: 1 / 0)
    assert main(arguments) == 0
    assert capsys.readouterr().out == first
