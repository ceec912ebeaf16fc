"""The figures: their content, axes, units and legends."""

from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from drivers.core.geometry import Array
from tests.vo_service.tools.compare.sample_runs import (
    CRASH,
    FRAMES,
    STEP_M,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.tools.compare.report.figures import (
    NamedFigure,
    line_style,
    make_error_figures,
    make_figures,
    make_trajectory_figures,
)
from vo_service.tools.compare.results import SequenceResults


def walk(**options: object) -> SequenceResults:
    """Make results: surf is off by 1 mm per step, icp by 3 mm with lost frames, sfm crashed."""
    recording = make_recording(gap_s=1.0)
    surf, icp = (
        make_outcome(recording, step_m=STEP_M + 0.001),
        make_outcome(recording, step_m=0.013, lost=range(20, 24)),
    )
    return make_results(recording, surf=surf, icp=icp, sfm=CRASH, **options)  # type: ignore[arg-type]


def figures(results: SequenceResults) -> dict[str, Figure]:
    return {named.name: named.figure for named in make_figures(results)}


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def curve(figure: Figure, plot: int, method: str) -> Array:
    """Return the points of the first line with a method's color, without gaps."""
    color = line_style(walk(), method)["color"]
    line = next(line for line in figure.axes[plot].lines if line.get_color() == color)
    points = np.asarray(line.get_xydata(), np.float64)
    return points[np.isfinite(points[:, 1])]


def test_the_errors_of_every_step_are_at_its_frame() -> None:
    by_name = figures(walk())
    assert list(by_name) == ["frame_error", "global_error", "trajectory"]
    above = curve(by_name["frame_error"], 0, "surf")
    np.testing.assert_allclose(above, [[k, 1.0] for k in range(1, FRAMES)], atol=1e-6)
    points = curve(by_name["global_error"], 0, "surf")
    np.testing.assert_allclose(points[1:], [[k, 0.001 * k] for k in range(1, FRAMES)], atol=1e-9)


def test_every_plot_has_axes_with_units_and_a_legend() -> None:
    figures_by_name = figures(walk())
    above, below = figures_by_name["frame_error"].axes
    assert (above.get_ylabel(), below.get_ylabel()) == (
        "error of a step (mm)",
        "error of a step (degrees)",
    )
    assert below.get_xlabel() == "frame"
    (plot,) = figures_by_name["global_error"].axes
    assert (plot.get_xlabel(), plot.get_ylabel()) == ("frame", "distance from the truth (m)")
    left, right = figures_by_name["trajectory"].axes
    assert (left.get_xlabel(), left.get_ylabel()) == ("right (m)", "forward (m)")
    assert (right.get_xlabel(), right.get_ylabel()) == ("forward (m)", "up (m)")
    known = ["surf", "icp", "frame lost", "pause in the recording"]
    assert (
        legend(figures_by_name["frame_error"]) == legend(figures_by_name["global_error"]) == known
    )
    assert legend(figures_by_name["trajectory"]) == ["ground truth", "surf", "icp"]


def test_very_different_methods_have_a_logarithmic_scale() -> None:
    recording = make_recording()
    result_figures = figures(
        make_results(
            recording,
            surf=make_outcome(recording, step_m=STEP_M + 1e-4),
            icp=make_outcome(recording, step_m=0.05),
        )
    )
    (plot,) = result_figures["global_error"].axes
    assert (plot.get_yscale(), plot.get_ylabel()) == (
        "log",
        "distance from the truth (m), logarithmic",
    )


def test_a_diverging_method_does_not_shrink_the_others() -> None:
    recording = make_recording()
    figure = figures(
        make_results(
            recording, surf=make_outcome(recording), icp=make_outcome(recording, step_m=1.0)
        )
    )["trajectory"]
    low, high = figure.axes[0].get_xlim()
    assert high - low < 5 * STEP_M * FRAMES
    assert "icp (leaves the figure)" in legend(figure)


def test_without_truth_there_are_only_trajectories() -> None:
    recording = make_recording(has_truth=False)
    figures_by_name = list(
        make_trajectory_figures(make_results(recording, surf=make_outcome(recording)))
    )
    assert list(make_error_figures(make_results(recording, surf=make_outcome(recording)))) == []
    assert legend(figures_by_name[0].figure) == ["surf"]
    assert "gray" not in figures_by_name[0].caption


def test_many_methods_have_different_lines_and_a_legend_of_several_rows() -> None:
    recording = make_recording()
    outcome = make_outcome(recording)
    others = {f"other-{k}": outcome for k in range(9)}
    results = make_results(recording, False, direct=outcome, **others)
    styles = [str(line_style(results, method)) for method in results.evaluations]
    assert len(set(styles)) == 10
    assert len(legend(figures(results)["global_error"])) == 10


def test_without_any_result_there_is_no_figure() -> None:
    assert figures(make_results(make_recording(), surf=CRASH)) == {}


def test_a_run_without_any_error_can_be_drawn() -> None:
    recording = make_recording()
    figures_by_name = figures(make_results(recording, surf=make_outcome(recording)))
    assert curve(figures_by_name["global_error"], 0, "surf")[:, 1].max() < 1e-9
    assert NamedFigure("frame_error", "", figures_by_name["frame_error"]).render("svg")


@pytest.mark.parametrize("lost", [range(3, FRAMES), range(16, FRAMES), range(FRAMES - 2)])
def test_a_run_with_few_poses_can_be_drawn(lost: range) -> None:
    recording = make_recording()
    assert "trajectory" in figures(make_results(recording, surf=make_outcome(recording, lost=lost)))


@pytest.mark.slow
def test_the_files_are_images_and_the_same_every_time() -> None:
    one, same = (next(iter(make_trajectory_figures(walk()))) for _ in range(2))
    svg = one.render("svg")
    assert svg == same.render("svg")
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    pixels = cv2.imdecode(np.frombuffer(one.render("png"), np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    assert pixels.std() > 5  # something is drawn on it
