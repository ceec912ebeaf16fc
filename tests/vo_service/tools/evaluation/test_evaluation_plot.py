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
TRUTH = random_walk(np.random.default_rng(1), np.arange(60) / 30)
TRACKED = np.r_[0:20, 30:60]
# The truth in another world frame, without frames 20 to 29.
TRAJECTORY = Trajectory(TRUTH.stamps_s[TRACKED], OTHER_WORLD @ TRUTH.T_world_camera[TRACKED])


def line(figure: Figure, plot: int, number: int) -> Array:
    return np.asarray(figure.axes[plot].lines[number].get_xydata())


def without_gaps(points: Array) -> Array:
    return points[np.isfinite(points[:, 0])]


def test_a_trajectory_from_another_world_is_aligned_with_the_truth() -> None:
    figure = draw_plot(TRAJECTORY, TRUTH, "walk")
    for view in (0, 1):
        assert np.allclose(without_gaps(line(figure, view, 1)), line(figure, view, 0)[TRACKED])
    assert np.allclose(without_gaps(line(figure, 2, 0))[:, 1], 0.0)


def test_the_views_are_right_and_forward_then_forward_and_up_of_the_first_camera() -> None:
    truth = random_walk(np.random.default_rng(2), np.arange(3.0))
    steps = [rigid_transform(np.eye(3), step) for step in ([0, 0, 0], [1, 2, 3], [2, 2, 3])]
    # x right, y down, z forward
    truth.T_world_camera[:] = truth.T_world_camera[0] @ np.array(steps)
    figure = draw_plot(truth, truth, "steps")
    assert np.allclose(line(figure, 0, 0), [[0, 0], [1, 3], [2, 3]])
    assert np.allclose(line(figure, 1, 0), [[0, 0], [3, -2], [3, -2]])


def test_no_line_is_drawn_where_the_trajectory_was_lost() -> None:
    figure = draw_plot(TRAJECTORY, TRUTH, "walk")
    for plot, number in ((0, 1), (1, 1), (2, 0)):
        assert np.flatnonzero(np.isnan(line(figure, plot, number)[:, 0])).tolist() == [20]


def test_truth_before_and_after_the_trajectory_is_left_out() -> None:
    short = Trajectory(TRUTH.stamps_s[10:20], TRUTH.T_world_camera[10:20])
    assert len(line(draw_plot(short, TRUTH, "short"), 0, 0)) == 10


def test_both_views_show_meters_to_one_scale_with_a_legend() -> None:
    above, side, errors = draw_plot(TRAJECTORY, TRUTH, "my walk").axes
    assert (above.get_xlabel(), above.get_ylabel()) == ("right (m)", "forward (m)")
    assert (side.get_xlabel(), side.get_ylabel()) == ("forward (m)", "up (m)")
    assert (errors.get_xlabel(), errors.get_ylabel()) == ("time (s)", "error (m)")
    assert above.get_aspect() == side.get_aspect() == 1.0
    legend = above.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["ground truth", "trajectory"]


@pytest.mark.slow
def test_the_suffix_selects_png_or_svg(tmp_path: Path) -> None:
    write_plot(tmp_path / "walk.PNG", TRAJECTORY, TRUTH, "walk")
    write_plot(tmp_path / "walk.svg", TRAJECTORY, TRUTH, "walk")
    image = cv2.imread(str(tmp_path / "walk.PNG"))
    assert image is not None
    assert image.shape == (800, 1100, 3)
    assert image.std() > 5  # something is drawn on it
    assert ElementTree.parse(tmp_path / "walk.svg").getroot().tag.endswith("svg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk.PNG", "walk.svg"]


def test_another_suffix_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"walk.jpg: the file name must end in .png or .svg"):
        write_plot(tmp_path / "walk.jpg", TRAJECTORY, TRUTH, "walk")


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
