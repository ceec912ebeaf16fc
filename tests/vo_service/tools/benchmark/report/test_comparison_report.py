"""The report folder is complete, self-contained and readable."""

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
from vo_service.config import Config, OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.terminal import Terminal
from vo_service.tools.benchmark import RunOutcome, RunState
from vo_service.tools.benchmark.methods import SfmScale
from vo_service.tools.benchmark.observers import LoopClosureObserverFactory
from vo_service.tools.benchmark.report import ComparisonMetadata
from vo_service.tools.benchmark.report.comparison_report import write_comparison_report
from vo_service.tools.benchmark.report.comparison_tables import metrics_table

pytestmark = pytest.mark.slow

VOID = {"meta", "img", "br", "link"}
FIGURES = [
    f"{name}.{suffix}"
    for name in ("walk-frame_error", "walk-global_error", "walk-trajectory")
    for suffix in ("png", "svg")
]


class Page(HTMLParser):
    """Parser of a page's text and links; it checks that all elements are closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.terms: list[str] = []
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
        if self.open[-1:] == ["dt"]:
            self.terms.append(data)


METADATA = ComparisonMetadata(["surf", "icp", "sfm"], Config(), SfmScale.FIRST_DEPTH, None, 3600.0)


@pytest.fixture(scope="module")
def report_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of two recordings: one with a gap, and one with special characters in its name."""
    folder = tmp_path_factory.mktemp("report")
    walk, odd = make_recording("walk", gap_s=1.0), make_recording("<b>odd & #1", has_truth=False)
    error = RunOutcome(RunState.ERROR, error="ValueError: <oh>", details="Traceback <here>")
    results = [
        make_results(
            walk,
            surf=make_outcome(walk, lost=range(20, 23)),
            icp=make_outcome(walk, step_m=0.02),
            sfm=CRASH,
        ),
        make_results(odd, surf=make_outcome(odd), icp=CRASH, sfm=error),
    ]
    write_comparison_report(folder, results, METADATA, Terminal())
    return folder


def test_the_folder_has_the_page_the_tables_the_figures_and_the_data(report_folder: Path) -> None:
    names = {path.name for path in report_folder.iterdir()}
    assert names == {
        "report.html", "report.json", "config.toml", "figures", "metrics.csv", "gaps.csv",
        "table_1_mean_global_error.csv", "table_2_processing_time.csv",
    }  # fmt: skip
    figures = {path.name for path in (report_folder / "figures").iterdir()}
    assert figures == {*FIGURES, "<b>odd & #1-trajectory.png", "<b>odd & #1-trajectory.svg"}
    with (report_folder / "metrics.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 6


def test_the_page_needs_no_other_source(report_folder: Path) -> None:
    html = (report_folder / "report.html").read_text()
    for link in Page(html).links:
        inside = link.startswith(("#", "data:image/svg+xml;base64,"))
        assert inside or (report_folder / unquote(link)).is_file()
    styles = html[html.index("<style>") : html.index("</style>")]
    assert "url(" not in styles
    assert "@import" not in styles
    assert "<script" not in html


def test_the_page_shows_results_and_errors(report_folder: Path) -> None:
    text = " ".join(Page((report_folder / "report.html").read_text()).text.split())
    for passage in (
        "SURF (proposed) has the smallest mean global error, 0.00 mm; ICP 195.00 mm.",
        "SfM: crashed (signal 11, Segmentation fault)",
        "<b>odd & #1: without ground truth, errors are not known.",
        "SfM: error: ValueError: <oh>",
        "Traceback <here>",
        "40 frames in 2.3 s, a path of 0.4 m, with ground truth, one pause of 1.0 s in total.",
        "lost 3 frames, then recovered",
        "# of # matches agree",
        "its first scale comes from the first depth images",
    ):
        assert passage in text


def test_every_metric_and_column_is_explained(report_folder: Path) -> None:
    html = (report_folder / "report.html").read_text()
    assert "CPU is the processor time of all frames, wall is the elapsed time" in html
    headings = metrics_table([make_results(make_recording())]).headings
    for heading in set(headings[2:-2]) - {"CPU s", "wall s"}:
        assert any(heading.startswith(term) for term in Page(html).terms), heading
    for caption in ("Error frame by frame (as", "Global error (as", "Trajectory of the camera (as"):
        assert caption in html


def test_the_page_fits_a_narrow_screen(report_folder: Path) -> None:
    html = (report_folder / "report.html").read_text()
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in html
    assert html.count("<table>") <= html.count('<div class="wide">')


def test_the_data_has_every_metric_under_stable_names(report_folder: Path) -> None:
    data = json.loads((report_folder / "report.json").read_text())
    assert data["schema"] == 1
    assert {"created", "methods", "odometry", "sfm_scale", "versions", "sequences"} <= set(data)
    walk, odd = data["sequences"]
    assert (walk["name"], walk["frames"], walk["has_ground_truth"]) == ("walk", 40, True)
    assert walk["methods"]["icp"]["mean_global_error_m"] == pytest.approx(0.195)
    assert walk["methods"]["sfm"]["state"] == "crashed"
    assert odd["methods"]["surf"]["ate_rmse_m"] is None
    assert odd["methods"]["sfm"]["state"] == "error"


def test_a_report_has_no_figures_of_an_earlier_one(tmp_path: Path) -> None:
    figures = tmp_path / "figures"
    figures.mkdir()
    for name in (*FIGURES, "other-trajectory.png"):
        (figures / name).touch()
    write_comparison_report(
        tmp_path, [make_results(make_recording(), surf=CRASH)], METADATA, Terminal()
    )
    assert [path.name for path in figures.iterdir()] == ["other-trajectory.png"]


def test_the_effective_configuration_can_be_read_again(tmp_path: Path) -> None:
    odometry = OdometryConfig(feature_count=700, upright=True)
    camera = Path('a "camera".toml')
    metadata = ComparisonMetadata(
        ["surf"], Config(odometry=odometry), SfmScale.GROUND_TRUTH, camera, 9.0
    )
    file = tmp_path / "config.toml"
    file.write_text(metadata.config_text)
    read = read_toml(file, Config)
    assert (read.odometry, read.camera.file) == (odometry, camera)
    assert "# First scale of sfm: --sfm-scale ground-truth" in metadata.config_text


def test_the_report_shows_the_effect_of_loop_closure(tmp_path: Path) -> None:
    walk = make_recording("walk")
    results = make_results(
        walk, True, surf=make_outcome(walk, loop_closure=make_loop_closure_run(walk))
    )
    loop_closure = LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20))
    metadata = ComparisonMetadata(
        ["surf"], Config(), SfmScale.FIRST_DEPTH, None, 3600.0, loop_closure
    )
    report = write_comparison_report(tmp_path, [results], metadata, Terminal())
    text = " ".join(Page(report.page.read_text()).text.split())
    assert "A place that is seen again shows how far the camera has drifted since." in text
    assert report.content["loop_closure"]["keyframe_database_mb"] == 20
    assert report.content["sequences"][0]["methods"]["surf"]["loop_closures"] == 2
    (row,) = csv.DictReader((tmp_path / "loop_closures.csv").read_text().splitlines())
    assert row["loop_closures"] == "2"
    assert read_toml(tmp_path / "config.toml", Config).map.keyframe_database_mb == 20


def test_without_loop_closure_the_report_does_not_mention_it(report_folder: Path) -> None:
    assert not (report_folder / "loop_closures.csv").exists()
    assert "loop_closure" not in (report_folder / "report.html").read_text()
    assert "loop_closure" not in (report_folder / "report.json").read_text()
