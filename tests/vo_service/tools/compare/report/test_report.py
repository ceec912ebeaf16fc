"""The report folder is complete, self-contained and readable."""

import csv
import json
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from drivers.core.config import read_toml
from tests.vo_service.tools.compare.sample_runs import (
    CRASH,
    make_loop_closure_run,
    make_outcome,
    make_recording,
    make_results,
)
from vo_service.config import Config, OdometryConfig
from vo_service.config_tables import MapConfig
from vo_service.terminal import Terminal
from vo_service.tools.compare.methods import SfmScale
from vo_service.tools.compare.observers import LoopClosureObserverFactory
from vo_service.tools.compare.report import report_folder as report_folder_module
from vo_service.tools.compare.report.metadata import ReportMetadata
from vo_service.tools.compare.report.report_folder import report_content, write_report
from vo_service.tools.compare.report.tables import cost_table, error_table
from vo_service.tools.compare.run_outcome import RunOutcome, RunState

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


METADATA = ReportMetadata(["surf", "icp", "sfm"], OdometryConfig(), 3600.0)


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
    write_report(folder, METADATA, results, Terminal())
    return folder


def test_the_folder_has_the_page_the_tables_the_figures_and_the_data(report_folder: Path) -> None:
    names = {path.name for path in report_folder.iterdir()}
    assert names == {
        "report.html", "report.json", "config.toml", "figures", "metrics.csv", "gaps.csv"
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
        "walk, every frame: surf has the smallest mean global error, 0.00 mm. "
        "surf has poses for only 92 % of the frames. sfm has no result (crashed).",
        "sfm: crashed (signal 11, Segmentation fault)",
        "<b>odd & #1, every frame: without ground truth, errors are not known.",
        "sfm: error: ValueError: <oh>",
        "Traceback <here>",
        "walk, every frame: 40 frames in 2.3 s",
        "A path of 0.4 m, with ground truth, one pause of 1.0 s in total.",
        "lost 3 frames, then recovered",
        "Without the pauses, the RPE of one frame is 0.0 mm for surf, 10.0 mm for icp.",
        "# of # matches agree",
        "the first scale comes from the first depth images",
    ):
        assert passage in text


def test_every_metric_and_column_is_explained(report_folder: Path) -> None:
    html = (report_folder / "report.html").read_text()
    results = make_results(make_recording())
    for heading in (*error_table(results).headings[1:], *cost_table(results).headings[1:]):
        if heading not in {"of", "median", "p95", "p99"}:
            assert any(heading.startswith(term) for term in Page(html).terms), heading
    for caption in ("Error frame by frame (as", "Global error (as", "Trajectory of the camera (as"):
        assert caption in html


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
    (tmp_path / "gaps.csv").touch()
    write_report(tmp_path, METADATA, [make_results(make_recording(), surf=CRASH)], Terminal())
    assert not (tmp_path / "gaps.csv").exists()
    assert [path.name for path in figures.iterdir()] == ["other-trajectory.png"]


def test_the_effective_configuration_can_be_read_again(tmp_path: Path) -> None:
    odometry = OdometryConfig(feature_count=700, upright=True)
    camera = Path('a "camera".toml')
    metadata = ReportMetadata(
        ["surf"], odometry, 9.0, sfm_scale=SfmScale.GROUND_TRUTH, camera_file=camera
    )
    file = tmp_path / "config.toml"
    file.write_text(metadata.config_text)
    read = read_toml(file, Config)
    assert (read.odometry, read.camera.file) == (odometry, camera)
    assert "# First scale of sfm: --sfm-scale ground-truth" in metadata.config_text


def test_the_report_shows_the_effect_of_loop_closure(tmp_path: Path) -> None:
    walk = make_recording("walk")
    outcome = make_outcome(walk, loop_closure=make_loop_closure_run(walk))
    results = [make_results(walk, True, surf=outcome)]
    loop_closure = LoopClosureObserverFactory(MapConfig(keyframe_database_mb=20))
    metadata = ReportMetadata(["surf"], OdometryConfig(), 3600.0, observer_factory=loop_closure)
    write_report(tmp_path, metadata, results, Terminal())
    text = " ".join(Page((tmp_path / "report.html").read_text()).text.split())
    assert "shows how far the camera has drifted since" in text
    content = report_content(metadata, results)
    assert content["loop_closure"]["keyframe_database_mb"] == 20
    assert content["sequences"][0]["methods"]["surf"]["loop_closures"] == 2
    assert read_toml(tmp_path / "config.toml", Config).map.keyframe_database_mb == 20


def test_without_loop_closure_the_report_does_not_mention_it(report_folder: Path) -> None:
    for name in ("report.html", "report.json", "metrics.csv"):
        assert "loop_closure" not in (report_folder / name).read_text()


def test_the_papers_results_are_in_the_report_of_its_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_folder_module, "make_figures", lambda results: iter(()))
    floor = make_recording("freiburg1_floor")
    results = [make_results(floor, surf=make_outcome(floor))]
    write_report(tmp_path, METADATA, results, Terminal())
    text = Page((tmp_path / "report.html").read_text()).text
    assert "Fontes and Maia, “Visual" in text
    assert (tmp_path / "paper.csv").exists()
    paper = report_content(METADATA, results)["sequences"][0]["paper"]
    assert paper["surf"] == {"mean_global_error_m": 0.05, "time_s": 458}


def test_a_folder_whose_name_is_no_text_has_a_report(tmp_path: Path) -> None:
    recording = make_recording("d\udce9")
    write_report(tmp_path, METADATA, [make_results(recording, surf=CRASH)], Terminal())
    assert r"d\udce9" in (tmp_path / "report.html").read_text()
