"""Relocalization in a saved map: evaluation of a start, and the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import multi_session
from benchmarks.__main__ import main
from benchmarks.multi_session import (
    SessionStartResult,
    build_map,
    relocalize_in_map,
    second_half_start,
)
from benchmarks.relocalization import TourSequence
from benchmarks.tours import compute_true_poses, make_tour_config
from drivers.camera import PinholeCamera
from drivers.core.geometry import T_BODY_CAMERA, inverse
from drivers.synthetic.renderer import make_renderer
from drivers.synthetic.sensors import RenderedImages

pytestmark = pytest.mark.slow

CAMERA = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
# Two places, then the first again.
THERE = [*range(0, 40, 2)]
WAY = THERE + THERE[::-1]


@pytest.fixture(scope="module")
def tour() -> TourSequence:
    config = replace(make_tour_config(1, 60.0, False), camera=CAMERA, texel_m=0.008)
    renderer, seen = make_renderer(config, 2), dict[int, RenderedImages]()

    def read_images(number: int) -> RenderedImages:
        shown = WAY[number]
        return seen[shown] if shown in seen else seen.setdefault(shown, renderer.render(shown))

    return TourSequence(config, read_images, compute_true_poses(config)[WAY])


def test_a_camera_that_starts_at_a_mapped_place_is_relocalized(
    tour: TourSequence, tmp_path: Path
) -> None:
    file = tmp_path / "day.keyframes"
    T_room_map = build_map("direct", tour, file)
    np.testing.assert_allclose(T_room_map, tour.T_room_camera[0] @ inverse(T_BODY_CAMERA))
    outcome = relocalize_in_map("direct", tour, file, T_room_map, second_half_start(tour))
    assert (outcome.frames, outcome.is_wrong) == (1, False)
    assert 0.0 < outcome.error_m <= outcome.settled_error_m < 0.02
    # The same poses, but another T_room_map.
    aside = T_room_map.copy()
    aside[0, 3] += 0.06
    assert relocalize_in_map("direct", tour, file, aside, second_half_start(tour)).is_wrong


def test_starts_are_counted_by_their_result() -> None:
    known, never = (
        SessionStartResult(3, 0.004, 0.1, 0.012, 0.2),
        SessionStartResult(None, 0, 0, 0, 0),
    )
    wrong = SessionStartResult(5, 0.006, 0.1, 0.06, 0.2)
    cells = multi_session.format_row("seed 1", [known, wrong, never]).split()
    assert cells == ["seed", "1", "3", "2", "1", "4", "5.0", "6.0", "0.10", "60.0", "0.20"]
    assert multi_session.format_row("seed 1", [never]).split()[2:5] == ["1", "0", "0"]


def test_each_seed_and_all_together_have_a_row(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    tour: TourSequence,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(TourSequence, "open", lambda *place: tour)
    monkeypatch.setattr(multi_session, "MAX_FRAMES", 10)
    arguments = ["multi_session", str(tmp_path), "--seeds", "1", "--starts", "2"]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:]] == [["seed", "1"], ["together", "2"]]
