"""The figure of a trajectory and its truth, drawn by matplotlib."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, rigid_transform, so3_exp
from tests.vo_service.tools.evaluation.sample_trajectories import random_walk
from vo_service.tools.evaluation.plot import draw_plot, write_plot

OTHER_WORLD = rigid_transform(so3_exp([1.0, -2.0, 0.5]), [4.0, 5.0, -6.0])


@pytest.fixture
def truth() -> Trajectory:
    return random_walk(np.random.default_rng(1), np.arange(60) / 30)


@pytest.fixture
def trajectory(truth: Trajectory) -> Trajectory:
    """The truth in another world frame, without frames 20 to 29."""
    tracked = np.r_[0:20, 30:60]
    return Trajectory(truth.stamps_s[tracked], OTHER_WORLD @ truth.T_world_camera[tracked])


def line(figure: Figure, plot: int, number: int) -> Array:
    return np.asarray(figure.axes[plot].lines[number].get_xydata())


def without_gaps(points: Array) -> Array:
    return points[np.isfinite(points[:, 0])]


def test_a_trajectory_from_another_world_is_aligned_with_the_truth(
    trajectory: Trajectory, truth: Trajectory
) -> None:
    figure = draw_plot(trajectory, truth, "walk")
    tracked = np.r_[0:20, 30:60]
    for view in (0, 1):
        assert np.allclose(without_gaps(line(figure, view, 1)), line(figure, view, 0)[tracked])
    assert np.allclose(without_gaps(line(figure, 2, 0))[:, 1], 0.0)


def test_the_views_are_right_and_forward_then_forward_and_up_of_the_first_camera() -> None:
    truth = random_walk(np.random.default_rng(2), np.arange(3.0))
    steps = [rigid_transform(np.eye(3), step) for step in ([0, 0, 0], [1, 2, 3], [2, 2, 3])]
    truth.T_world_camera[:] = truth.T_world_camera[0] @ np.array(
        steps
    )  # x right, y down, z forward
    figure = draw_plot(truth, truth, "steps")
    assert np.allclose(line(figure, 0, 0), [[0, 0], [1, 3], [2, 3]])
    assert np.allclose(line(figure, 1, 0), [[0, 0], [3, -2], [3, -2]])


def test_no_line_is_drawn_where_the_trajectory_was_lost(
    trajectory: Trajectory, truth: Trajectory
) -> None:
    figure = draw_plot(trajectory, truth, "walk")
    for plot, number in ((0, 1), (1, 1), (2, 0)):
        assert np.flatnonzero(np.isnan(line(figure, plot, number)[:, 0])).tolist() == [20]


def test_truth_before_and_after_the_trajectory_is_left_out(truth: Trajectory) -> None:
    short = Trajectory(truth.stamps_s[10:20], truth.T_world_camera[10:20])
    assert len(line(draw_plot(short, truth, "short"), 0, 0)) == 10


def test_both_views_show_meters_to_one_scale_with_a_legend(
    trajectory: Trajectory, truth: Trajectory
) -> None:
    above, side, errors = draw_plot(trajectory, truth, "my walk").axes
    assert (above.get_xlabel(), above.get_ylabel()) == ("right (m)", "forward (m)")
    assert (side.get_xlabel(), side.get_ylabel()) == ("forward (m)", "up (m)")
    assert (errors.get_xlabel(), errors.get_ylabel()) == ("time (s)", "error (m)")
    assert above.get_aspect() == side.get_aspect() == 1.0
    legend = above.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["ground truth", "trajectory"]


@pytest.mark.slow
def test_the_suffix_selects_png_or_svg(
    tmp_path: Path, trajectory: Trajectory, truth: Trajectory
) -> None:
    write_plot(tmp_path / "walk.PNG", trajectory, truth, "walk")
    write_plot(tmp_path / "walk.svg", trajectory, truth, "walk")
    image = cv2.imread(str(tmp_path / "walk.PNG"))
    assert image is not None
    assert image.shape == (800, 1100, 3)
    assert image.std() > 5  # something is drawn on it
    assert ElementTree.parse(tmp_path / "walk.svg").getroot().tag.endswith("svg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk.PNG", "walk.svg"]


def test_another_suffix_is_rejected(
    tmp_path: Path, trajectory: Trajectory, truth: Trajectory
) -> None:
    with pytest.raises(InputError, match=r"walk.jpg: the file name must end in .png or .svg"):
        write_plot(tmp_path / "walk.jpg", trajectory, truth, "walk")


def test_a_missing_folder_is_reported(
    tmp_path: Path, trajectory: Trajectory, truth: Trajectory
) -> None:
    with pytest.raises(InputError, match=r"gone/walk.png: there is no folder"):
        write_plot(tmp_path / "gone" / "walk.png", trajectory, truth, "walk")


@pytest.mark.subprocess
def test_drawing_needs_no_pyplot_and_evaluating_no_matplotlib() -> None:
    program = """
import sys
import numpy as np
import vo_service.cli.evaluate
from drivers.core.geometry import Trajectory
from vo_service.tools.evaluation.plot import draw_plot
assert not any(name.startswith("matplotlib") for name in sys.modules)
poses = Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)))
draw_plot(poses, poses, "still")
assert "matplotlib" in sys.modules
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=100)
