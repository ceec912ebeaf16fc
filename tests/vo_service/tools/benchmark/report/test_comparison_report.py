"""The report's folder: whole, self-contained, readable."""

import csv
import json
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from drivers.core.config import read_toml
from tests.vo_service.tools.benchmark.sample_runs import (
    CRASH,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.cli.loop_closure_observer import LoopClosureObserverFactory
from vo_service.config import Config, OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.terminal import Terminal
from vo_service.tools.benchmark.method_factory import SfmScale
from vo_service.tools.benchmark.report.comparison_report import write_comparison_report
from vo_service.tools.benchmark.report.help_texts import (
    ERROR_TEXT,
    INTRODUCTION_TEXT,
    LOOP_CLOSURE_TEXT,
    METRIC_TEXTS,
    TIME_TEXT,
)
from vo_service.tools.benchmark.report.metadata import ComparisonMetadata
from vo_service.tools.benchmark.run import RunOutcome, RunState

pytestmark = pytest.mark.slow

VOID = {"meta", "img", "br", "link"}
FIGURES = [
    f"{name}.{suffix}"
    for name in ("walk-frame_error", "walk-global_error", "walk-trajectory")
    for suffix in ("png", "svg")
]


class Page(HTMLParser):
    """Text and links of a page whose elements are all closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value for name, value in attrs if name in ("src", "href") and value]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


SET_UP = ComparisonMetadata(["surf", "icp", "sfm"], Config(), SfmScale.FIRST_DEPTH, None, 3600.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two recordings: one with a pause, and one with a name to beware of."""
    folder = tmp_path_factory.mktemp("report")
    walk, odd = make_recording("walk", gap_s=1.0), make_recording("<b>odd & #1", has_truth=False)
    error = RunOutcome(RunState.ERROR, error="ValueError: <oh>", details="Traceback <here>")
    found = [
        make_results(
            walk,
            surf=make_outcome(walk, lost=range(20, 23)),
            icp=make_outcome(walk, step_m=0.02),
            sfm=CRASH,
        ),
        make_results(odd, surf=make_outcome(odd), icp=CRASH, sfm=error),
    ]
    write_comparison_report(folder, found, SET_UP, Terminal())
    return folder


def test_the_folder_has_the_page_the_tables_the_figures_and_the_data(written: Path) -> None:
    names = {path.name for path in written.iterdir()}
    assert names == {
        "report.html", "report.json", "config.toml", "figures", "metrics.csv", "gaps.csv",
        "table_1_mean_global_error.csv", "table_2_processing_time.csv",
    }  # fmt: skip
    drawn = {path.name for path in (written / "figures").iterdir()}
    assert drawn == {*FIGURES, "<b>odd & #1-trajectory.png", "<b>odd & #1-trajectory.svg"}
    with (written / "metrics.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 6


def test_the_page_needs_nothing_from_elsewhere(written: Path) -> None:
    html = (written / "report.html").read_text()
    for link in Page(html).links:
        inside = link.startswith(("#", "data:image/svg+xml;base64,"))
        assert inside or (written / unquote(link)).is_file()
    styles = html[html.index("<style>") : html.index("</style>")]
    assert "url(" not in styles
    assert "@import" not in styles
    assert "<script" not in html


def test_the_page_tells_what_came_out_and_what_went_wrong(written: Path) -> None:
    text = Page((written / "report.html").read_text()).text
    for told in (
        "SURF (proposed) has the smallest mean global error, 0.00 mm; ICP 195.00 mm.",
        "SfM: crashed (signal 11, Segmentation fault)",
        "<b>odd & #1: without ground truth, errors cannot be told.",
        "SfM: error: ValueError: <oh>",
        "Traceback <here>",
        "40 frames in 2.3 s, a way of 0.4 m, with ground truth, one pause of 1.0 s together.",
        "lost 3 frames, then found again",
        "# of # matches agree",
        "its first metre is taken from the first depth images",
    ):
        assert told in text


def test_every_figure_and_column_is_explained(written: Path) -> None:
    text = Page((written / "report.html").read_text()).text
    for word, meaning in (
        *METRIC_TEXTS,
        ("", INTRODUCTION_TEXT),
        ("", ERROR_TEXT),
        ("", TIME_TEXT),
    ):
        assert word + meaning in text
    for caption in ("Error frame by frame (as", "Global error (as", "The way of the camera (as"):
        assert caption in text


def test_the_page_fits_a_narrow_screen(written: Path) -> None:
    html = (written / "report.html").read_text()
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in html
    assert html.count("<table>") <= html.count('<div class="wide">')


def test_the_data_has_every_figure_under_names_that_stay(written: Path) -> None:
    data = json.loads((written / "report.json").read_text())
    assert data["schema"] == 1
    assert {"created", "methods", "odometry", "sfm_scale", "versions", "sequences"} <= set(data)
    walk, odd = data["sequences"]
    assert (walk["name"], walk["frames"], walk["has_ground_truth"]) == ("walk", 40, True)
    assert walk["methods"]["icp"]["mean_global_error_m"] == pytest.approx(0.195)
    assert walk["methods"]["sfm"]["state"] == "crashed"
    assert odd["methods"]["surf"]["ate_rmse_m"] is None
    assert odd["methods"]["sfm"]["state"] == "error"


def test_a_report_has_no_figures_of_the_one_before(tmp_path: Path) -> None:
    figures = tmp_path / "figures"
    figures.mkdir()
    for name in (*FIGURES, "other-trajectory.png"):
        (figures / name).touch()
    write_comparison_report(
        tmp_path, [make_results(make_recording(), surf=CRASH)], SET_UP, Terminal()
    )
    assert [path.name for path in figures.iterdir()] == ["other-trajectory.png"]


def test_the_effective_configuration_can_be_given_again(tmp_path: Path) -> None:
    odometry = OdometryConfig(feature_count=700, upright=True)
    camera = Path('a "camera".toml')
    set_up = ComparisonMetadata(
        ["surf"], Config(odometry=odometry), SfmScale.GROUND_TRUTH, camera, 9.0
    )
    file = tmp_path / "config.toml"
    file.write_text(set_up.config_text)
    read = read_toml(file, Config)
    assert (read.odometry, read.camera.file) == (odometry, camera)
    assert "# First scale of sfm: --sfm-scale ground-truth" in set_up.config_text


def test_with_loops_the_report_says_what_they_have_gained(tmp_path: Path) -> None:
    walk = make_recording("walk")
    found = make_results(
        walk, True, surf=make_outcome(walk, with_loops=make_loop_closure_run(walk))
    )
    loops = LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20))
    set_up = ComparisonMetadata(["surf"], Config(), SfmScale.FIRST_DEPTH, None, 3600.0, loops)
    report = write_comparison_report(tmp_path, [found], set_up, Terminal())
    text = " ".join(Page(report.page.read_text()).text.split())
    assert LOOP_CLOSURE_TEXT in text
    assert report.content["loop_closure"]["keyframe_database_mb"] == 20
    assert report.content["sequences"][0]["methods"]["surf"]["loop_closures"] == 2
    (row,) = csv.DictReader((tmp_path / "loop_closures.csv").read_text().splitlines())
    assert row["loop_closures"] == "2"
    assert read_toml(tmp_path / "config.toml", Config).map.keyframe_database_mb == 20


def test_without_loops_nothing_of_them_is_in_the_report(written: Path) -> None:
    assert not (written / "loop_closures.csv").exists()
    assert "loop_closure" not in (written / "report.html").read_text()
    assert "loop_closure" not in (written / "report.json").read_text()
