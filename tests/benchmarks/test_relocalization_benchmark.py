"""Relocalization trials: their choice by view overlap, and their evaluation by the truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import relocalization
from benchmarks.__main__ import main
from benchmarks.relocalization import (
    FRAMES_AFTER,
    FRAMES_BEFORE,
    FRAMES_COVERED,
    VIEW_STRIDE,
    ObservedView,
    RelocalizationOutcome,
    RelocalizationTrial,
    TourSequence,
    choose_trials,
    evaluate_trial,
    format_row,
    trial_frames,
)
from benchmarks.tours import compute_true_poses, make_tour_config
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.sensors import RenderedImages
from tests.vo_service.fakes import good_estimate, make_frame
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate

CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)
# First uncovered frame of a trial.
BACK = FRAMES_BEFORE + FRAMES_COVERED
# The frame at which the old map is aligned with the truth.
ALIKE = 300


def wall(distance_m: float = 2.0) -> RgbdFrame:
    depth = np.full((480, 640), round(1000 * distance_m), np.uint16)
    return replace(
        make_frame(0),
        camera=CAMERA,
        depth_factor=1000.0,
        depth_raw=depth,
        color_bgr=np.zeros((480, 640, 3), np.uint8),
    )


def test_the_overlap_of_two_views_is_what_both_see() -> None:
    here = ObservedView.from_frame(wall(), np.eye(4))
    assert here.overlap_with(here) == 1.0
    half_a_view_m = 320 / 525 * 2.0
    aside = ObservedView.from_frame(wall(), rigid_transform(np.eye(3), (half_a_view_m, 0.0, 0.0)))
    assert here.overlap_with(aside) == pytest.approx(0.5, abs=0.06)
    turned = rigid_transform(so3_exp([0.0, np.pi, 0.0]), (0.0, 0.0, 0.0))
    assert here.overlap_with(ObservedView.from_frame(wall(), turned)) == 0.0
    assert here.overlap_with(ObservedView.from_frame(wall(1.8), np.eye(4))) == 0.0


# Two laps past fifty places, and five seconds elsewhere.
PLACES = np.array([*(number % 50 for number in range(100)), *[99] * 10])
LAPS = np.equal.outer(PLACES, PLACES).astype(float)


@pytest.mark.parametrize("unseen", [False, True])
def test_a_trial_returns_to_a_seen_or_an_unseen_place(unseen: bool) -> None:
    tries = choose_trials(LAPS, 10, unseen, np.random.default_rng(1))
    assert len({each.first for each in tries}) == len(tries) == 10
    for each in tries:
        views = [PLACES[shown // VIEW_STRIDE] for shown in each.source_frames]
        assert len(views) == FRAMES_BEFORE + FRAMES_COVERED + FRAMES_AFTER
        assert each.return_frame >= each.first + BACK
        assert each.first <= each.overlap_frame < each.first + FRAMES_BEFORE
        is_alike = PLACES[each.overlap_frame // VIEW_STRIDE] == views[BACK]
        assert is_alike != unseen
        known = set(views[:FRAMES_BEFORE])
        assert {view in known for view in views[BACK:][:30]} == {not unseen}


def test_there_are_no_more_trials_than_the_tour_allows() -> None:
    tries = choose_trials(LAPS[:60, :60], 100, False, np.random.default_rng(1))
    assert len(tries) < 20
    assert choose_trials(LAPS[:48, :48], 100, True, np.random.default_rng(1)) == []


def test_covered_frames_are_black_and_have_increasing_stamps() -> None:
    config = replace(make_tour_config(1, 60.0, False), camera=TINY)

    def read_images(number: int) -> RenderedImages:
        return RenderedImages(
            np.full((48, 64, 3), number % 251, np.uint8), np.full((48, 64), number, np.uint16)
        )

    tour = TourSequence(config, read_images, np.empty((0, 4, 4)))
    frames = list(trial_frames(RelocalizationTrial(30, 900, 30), tour))
    assert [each.seq for each in frames] == list(range(len(frames)))
    np.testing.assert_allclose(np.diff([each.stamp_s for each in frames]), 1 / 30, atol=2e-6)
    assert [each.depth_raw.max() for each in frames[FRAMES_BEFORE - 1 : BACK + 2]] == [
        30 + FRAMES_BEFORE - 1,
        *[0] * FRAMES_COVERED,
        900,
        901,
    ]
    assert {each.color_bgr.max() for each in frames[FRAMES_BEFORE:BACK]} == {0}


@dataclass
class ScriptedTrial:
    """True estimates of a trial, except for scripted errors."""

    truth: Array

    def make_estimates(
        self, waits: int, is_new: bool = False, off_m: float = 0.0, off_from: int = 0
    ) -> list[Estimate]:
        """Make estimates with the first pose after some frames and an error from `off_from` on."""
        T_old = inverse(self.truth[0])
        T_new = inverse(self.truth[BACK + waits])
        estimates = []
        for number, T_room_camera in enumerate(self.truth):
            is_after = number >= BACK + waits
            T = (T_new if is_new and is_after else T_old) @ T_room_camera
            if is_after and number >= BACK + waits + off_from:
                T = rigid_transform(np.eye(3), (off_m, 0.0, 0.0)) @ T
            estimates.append(
                Estimate(
                    number < FRAMES_BEFORE or is_after,
                    "",
                    T,
                    np.eye(4),
                    np.eye(6),
                    is_reset=is_new and number == BACK + waits,
                )
            )
        return estimates


@pytest.fixture(scope="module")
def scripted_trial() -> ScriptedTrial:
    return ScriptedTrial(
        compute_true_poses(make_tour_config(1, 60.0, False))[
            RelocalizationTrial(0, 900, 0).source_frames
        ]
    )


def test_a_relocalization_in_the_old_map_is_compared_with_its_truth(
    scripted_trial: ScriptedTrial,
) -> None:
    outcome = evaluate_trial(
        scripted_trial.make_estimates(waits=4, off_m=0.03), scripted_trial.truth, ALIKE
    )
    assert (outcome.frames, outcome.is_old_map, outcome.is_wrong) == (5, True, False)
    assert outcome.error_m == pytest.approx(0.03, abs=1e-6)
    assert outcome.error_deg == pytest.approx(0.0, abs=1e-4)
    assert evaluate_trial(
        scripted_trial.make_estimates(waits=4, off_m=0.06), scripted_trial.truth, ALIKE
    ).is_wrong
    assert evaluate_trial(
        scripted_trial.make_estimates(waits=4, off_m=0.06, off_from=9), scripted_trial.truth, ALIKE
    ).is_wrong


def test_drift_elsewhere_is_not_an_error_of_the_relocalization(
    scripted_trial: ScriptedTrial,
) -> None:
    drift = rigid_transform(np.eye(3), (0.0, 0.2, 0.0))
    estimates = [
        replace(each, T_world_camera=drift @ each.T_world_camera) if ALIKE < n < BACK else each
        for n, each in enumerate(scripted_trial.make_estimates(waits=0))
    ]
    assert evaluate_trial(estimates, scripted_trial.truth, ALIKE).error_m == pytest.approx(
        0.0, abs=1e-6
    )
    assert evaluate_trial(
        estimates, scripted_trial.truth, FRAMES_BEFORE - 1
    ).error_m == pytest.approx(0.2, abs=1e-6)


def test_a_new_map_is_compared_with_the_motion_since_its_first_pose(
    scripted_trial: ScriptedTrial,
) -> None:
    outcome = evaluate_trial(
        scripted_trial.make_estimates(waits=0, is_new=True, off_m=0.06), scripted_trial.truth, ALIKE
    )
    assert outcome == RelocalizationOutcome(1, False, None, None, False)
    assert evaluate_trial(
        scripted_trial.make_estimates(0, is_new=True, off_m=0.06, off_from=1),
        scripted_trial.truth,
        ALIKE,
    ).is_wrong


def test_a_trial_without_a_pose_is_nowhere_but_not_wrong(scripted_trial: ScriptedTrial) -> None:
    estimates = [
        replace(each, ok=n < FRAMES_BEFORE)
        for n, each in enumerate(scripted_trial.make_estimates(0))
    ]
    assert evaluate_trial(estimates, scripted_trial.truth, ALIKE) == RelocalizationOutcome(
        None, False, None, None, False
    )


def outcome(
    frames: int | None, error_m: float | None = None, wrong: bool = False
) -> RelocalizationOutcome:
    error_deg = None if error_m is None else 0.5
    return RelocalizationOutcome(frames, error_m is not None, error_m, error_deg, wrong)


def test_trials_are_counted_by_their_outcome() -> None:
    back = [outcome(3, 0.01), outcome(40, 0.02), outcome(2, 0.3, wrong=True)]
    outcomes = [*back, outcome(1), outcome(None)]
    tries, old, prompt, new, nowhere, wrong, *cells = format_row("all", outcomes).split()[1:]
    assert (tries, old, prompt) == ("5", "3", "2")
    assert (new, nowhere, wrong) == ("1", "1", "1")
    assert cells == ["3.0", "20.0", "300.0", "0.5"]
    assert format_row("none", []).split()[7:] == ["-"] * 4


@pytest.mark.slow
def test_each_seed_and_all_together_have_a_row(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def tiny(seed: int, seconds: float, aliased_corners: bool) -> SyntheticConfig:
        config = make_tour_config(seed, seconds, aliased_corners)
        return replace(config, camera=TINY, texel_m=0.05)

    monkeypatch.setattr(relocalization, "make_tour_config", tiny)
    monkeypatch.setattr(relocalization, "LoopClosureRunner", OdometryRunner)
    monkeypatch.setattr(relocalization, "SEQUENCE_S", 6.0)
    for name, count in (("FRAMES_BEFORE", 60), ("FRAMES_COVERED", 30), ("FRAMES_AFTER", 30)):
        monkeypatch.setattr(relocalization, name, count)
    monkeypatch.setattr(relocalization, "choose_trials", _two_trials)
    arguments = ["relocalization", str(tmp_path), "--tries", "3", "--seeds", "1"]
    arguments += ["--method", "icp"]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line.split()[:2] for line in lines[1:]]
    assert rows == [["tour-1-seen-icp", "2"], ["together", "2"]]


class OdometryRunner:
    """A runner without a map, whose camera stands."""

    def __init__(self, method: str) -> None:
        assert method == "icp"

    def process(self, frame: RgbdFrame) -> OdometryUpdate:
        """Return the same pose for each frame."""
        return replace(make_update(frame.seq), estimate=good_estimate(np.eye(4)))


def _two_trials(
    overlaps: Array, count: int, unseen: bool, rng: np.random.Generator
) -> list[RelocalizationTrial]:
    assert (len(overlaps), count, unseen) == (12, 3, False)
    return [RelocalizationTrial(0, 100, 0), RelocalizationTrial(15, 130, 15)]
