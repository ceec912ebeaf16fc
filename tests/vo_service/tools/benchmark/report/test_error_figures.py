"""The figures: what they show, and that a stranger finds axes, units and a legend."""

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from drivers.core.geometry import Array
from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.benchmark.report.comparison_report import render_figure
from vo_service.tools.benchmark.report.error_figures import (
    NamedFigure,
    make_error_figures,
    method_color,
)
from vo_service.tools.benchmark.report.trajectory_figure import make_trajectory_figures
from vo_service.tools.benchmark.results import SequenceResults


def walk(**how: object) -> SequenceResults:
    """Surf is 1 mm off a step, icp 3 mm and loses frames at a pause, sfm has crashed."""
    of = make_recording(gap_s=1.0)
    surf, icp = (
        make_outcome(of, step_m=STEP_M + 0.001),
        make_outcome(of, step_m=0.013, lost=range(20, 24)),
    )
    return make_results(of, surf=surf, icp=icp, sfm=CRASH, **how)  # type: ignore[arg-type]


def figures(of: SequenceResults) -> dict[str, Figure]:
    drawn = [*make_error_figures(of), *make_trajectory_figures(of)]
    return {named.name: named.figure for named in drawn}


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def curve(figure: Figure, plot: int, method: str) -> Array:
    """The first line of a method's color; where it is broken is left out."""
    color = method_color(method, ["surf", "icp", "sfm"])
    line = next(line for line in figure.axes[plot].lines if line.get_color() == color)
    points = np.asarray(line.get_xydata(), np.float64)
    return points[np.isfinite(points[:, 1])]


def test_there_is_one_of_each_kind_with_what_it_is_for() -> None:
    drawn = [*make_error_figures(walk()), *make_trajectory_figures(walk())]
    assert [named.name for named in drawn] == ["frame_error", "global_error", "trajectory"]
    captions = [named.caption for named in drawn]
    for word in ("Error frame by frame", "Global error"):
        assert any(
            caption.startswith(f"{word} (as the paper's Figures 6 to 9)") for caption in captions
        )
    assert captions[2].startswith("The way of the camera (as the paper's Figure 10)")


def test_the_error_of_every_step_stands_at_its_frame() -> None:
    above = curve(figures(walk())["frame_error"], 0, "surf")
    np.testing.assert_allclose(above, [[k, 1.0] for k in range(1, FRAMES)], atol=1e-6)


def test_the_global_error_grows_with_the_steps() -> None:
    points = curve(figures(walk())["global_error"], 0, "surf")
    np.testing.assert_allclose(points[1:], [[k, 0.001 * k] for k in range(1, FRAMES)], atol=1e-9)


def test_every_plot_has_axes_with_units_and_a_legend() -> None:
    drawn = figures(walk())
    above, below = drawn["frame_error"].axes
    assert (above.get_ylabel(), below.get_ylabel()) == (
        "error of a step (mm)",
        "error of a step (degrees)",
    )
    assert below.get_xlabel() == "frame"
    (plot,) = drawn["global_error"].axes
    assert (plot.get_xlabel(), plot.get_ylabel()) == ("frame", "distance from the truth (m)")
    left, right = drawn["trajectory"].axes
    assert (left.get_xlabel(), left.get_ylabel()) == ("right (m)", "forward (m)")
    assert (right.get_xlabel(), right.get_ylabel()) == ("forward (m)", "up (m)")
    known = ["SURF (proposed)", "ICP", "frame lost", "pause in the recording"]
    assert legend(drawn["frame_error"]) == legend(drawn["global_error"]) == known
    assert legend(drawn["trajectory"]) == ["ground truth", "SURF (proposed)", "ICP"]


def test_methods_that_differ_much_are_drawn_to_a_logarithmic_scale() -> None:
    of = make_recording()
    much = figures(
        make_results(
            of, surf=make_outcome(of, step_m=STEP_M + 1e-4), icp=make_outcome(of, step_m=0.05)
        )
    )
    (plot,) = much["global_error"].axes
    assert (plot.get_yscale(), plot.get_ylabel()) == (
        "log",
        "distance from the truth (m), logarithmic",
    )


def test_a_method_that_flies_off_does_not_make_the_others_small() -> None:
    of = make_recording()
    figure = figures(make_results(of, surf=make_outcome(of), icp=make_outcome(of, step_m=1.0)))[
        "trajectory"
    ]
    low, high = figure.axes[0].get_xlim()
    assert high - low < 5 * STEP_M * FRAMES
    assert "ICP (leaves the picture)" in legend(figure)


def test_without_truth_there_are_trajectories_alone() -> None:
    of = make_recording(has_truth=False)
    drawn = list(make_trajectory_figures(make_results(of, surf=make_outcome(of))))
    assert list(make_error_figures(make_results(of, surf=make_outcome(of)))) == []
    assert legend(drawn[0].figure) == ["SURF (proposed)"]
    assert "gray" not in drawn[0].caption


def test_without_any_result_there_is_no_figure() -> None:
    assert figures(make_results(make_recording(), surf=CRASH)) == {}


def test_a_run_without_any_error_can_be_drawn() -> None:
    of = make_recording()
    drawn = figures(make_results(of, surf=make_outcome(of)))
    assert curve(drawn["global_error"], 0, "surf")[:, 1].max() < 1e-9
    assert render_figure(NamedFigure("frame_error", "", drawn["frame_error"]), "svg")


@pytest.mark.parametrize("lost", [range(3, FRAMES), range(16, FRAMES), range(FRAMES - 2)])
def test_a_run_of_few_poses_can_be_drawn(lost: range) -> None:
    of = make_recording()
    assert "trajectory" in figures(make_results(of, surf=make_outcome(of, lost=lost)))


@pytest.mark.slow
def test_the_files_are_images_and_the_same_every_time() -> None:
    one, same = (next(iter(make_trajectory_figures(walk()))) for _ in range(2))
    svg = render_figure(one, "svg")
    assert svg == render_figure(same, "svg")
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    pixels = cv2.imdecode(np.frombuffer(render_figure(one, "png"), np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    assert pixels.std() > 5  # something is drawn on it
