"""``demo``: the whole line on the virtual Kinect, and what it leaves behind."""

import json
from functools import partial
from pathlib import Path

import pytest

from drivers.camera import PinholeCamera
from drivers.core.geometry import read_trajectory
from drivers.synthetic.config import SyntheticConfig
from tests.vo_service.cli.cli_runner import KinectVo
from vo_service.cli import demo

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

# Half a second of them. A busy machine drops most of them, as a robot would.
FRAMES = 15


@pytest.fixture(scope="module")
def render_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that keeps the rendered sequence for the next test."""
    return tmp_path_factory.mktemp("render_cache")


@pytest.fixture(autouse=True)
def short(render_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", str(render_cache))
    # A small camera in a coarse room: rendered in a second, not in ten.
    small = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
    config = partial(SyntheticConfig, texel_m=0.02, camera=small)
    monkeypatch.setattr(demo, "SyntheticConfig", config)


def test_every_frame_is_played_and_trajectory_truth_and_figure_are_written(
    config: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = tmp_path / "demo"
    options = ("--seconds", "0.5", "--no-serve", "--config", config, "--output", folder)
    outcome = kinect_vo("demo", *options, "--json")
    assert outcome.code == 0
    figures = json.loads(outcome.out)
    assert figures["frames"] + figures["dropped"] == FRAMES
    assert figures["frames"] >= 3
    assert figures["ate_rmse_m"] < 0.02
    assert len(read_trajectory(folder / "trajectory.txt")) == figures["frames"]
    assert len(read_trajectory(folder / "groundtruth.txt")) == FRAMES
    assert (folder / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "demo.rrd").stat().st_size > 10_000


def test_the_terminal_shows_the_results_and_their_files(
    config: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    folder = tmp_path / "demo"
    options = ("--seconds", "0.5", "--no-serve", "--config", config, "--output", folder)
    outcome = kinect_vo("demo", *options)
    output = outcome.out + outcome.err
    for words in ("kinect-vo listen", f"results: {folder}", "ATE, RMSE", "latency"):
        assert words in output
