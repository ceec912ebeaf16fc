"""Results: their data, the pages written from them, and the commands that measure them."""

from pathlib import Path

import pytest

from benchmarks.console_tables import read_tables
from benchmarks.result_pages import PAGES, ResultData, read_results, render_page, write_results
from benchmarks.results import run_commands, update

FILES = sorted(PAGES.glob("*.json"))
BENCH = "kinect-vo compare room --methods direct"
OUTPUT = """room_desk, every frame: 360 frames
method          ATE mm   lost
direct     0.58 (1.00)      0
surf       8.43 (14.5)      -

method   CPU ms mean   median
direct           3.1      2.6
surf             6.9      6.7
note: a vocabulary
kitchen, every frame: 500 frames
method   ATE mm   lost
direct    23.38      0
"""
DATA = ResultData(
    name="errors",
    command=BENCH,
    by_hand=False,
    date="2026-01-01",
    commit="abc",
    machine="a machine",
    columns=["recording", "error"],
    rows=[["desk", 1.5], ["room", "10 to 200"]],
    shown=[],
    plot="error",
)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_tables_and_plots_of_a_page_are_those_of_its_data(file: Path) -> None:
    results = {result.name: result for result in read_results(file)}
    page = file.with_suffix(".md").read_text()
    assert render_page(page, results) == page
    assert "```console" not in page
    for name, result in results.items():
        assert f"<!-- result: {name} -->" in page
        assert not result.plot or (PAGES / "plots" / f"{name}.svg").read_text() == result.draw()


def test_each_plot_has_its_data() -> None:
    plots = {result.name for file in FILES for result in read_results(file) if result.plot}
    assert {plot.stem for plot in (PAGES / "plots").iterdir()} == plots


def test_each_measured_result_has_its_date_commit_and_machine() -> None:
    for result in (result for file in FILES for result in read_results(file)):
        assert result.machine
        assert bool(result.command) == bool(result.date) == bool(result.commit)


def test_the_tables_of_an_output_become_one() -> None:
    columns, rows = read_tables(OUTPUT)
    assert columns == ["recording", "", "ATE mm", "lost", "CPU ms mean", "CPU ms median"]
    assert rows == [
        ["room_desk", "direct", 0.58, 0, 3.1, 2.6],
        ["room_desk", "surf", 8.43, None, 6.9, 6.7],
        ["kitchen", "direct", 23.38, 0, None, None],
    ]


def test_a_result_has_the_figures_of_its_command() -> None:
    run = {"output": "      ATE  lost\ndesk  2.5  0\n", "date": "2026-11-25", "commit": "def"}
    new = update(DATA, {BENCH: {**run, "machine": "another"}})
    assert (new.date, new.commit, new.machine) == ("2026-11-25", "def", "another")
    assert (new.columns, new.rows) == (["", "ATE", "lost"], [["desk", 2.5, 0]])
    assert update(DATA, {}) == DATA


def test_a_page_keeps_its_text_around_a_block(tmp_path: Path) -> None:
    write_results(tmp_path / "page.json", [DATA])
    assert read_results(tmp_path / "page.json") == [DATA]
    page = render_page("# A\n\n<!-- result: errors -->\n<!-- end -->\nB\n", {"errors": DATA})
    assert page.startswith("# A\n\n<!-- result: errors -->\n")
    assert "| desk | 1.5 |\n| room | 10 to 200 |" in page
    assert page.endswith("<!-- end -->\nB\n")


def test_a_plot_has_a_bar_for_each_figure_and_range() -> None:
    plot = DATA.draw()
    assert plot.count("<rect") == 2
    assert ">error, logarithmic<" in plot
    assert ">10 to 200<" in plot


@pytest.mark.subprocess
def test_a_command_with_a_result_is_not_run_again(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "room").mkdir()
    commands = ["kinect-vo --version", "kinect-vo evaluate room room"]
    first = run_commands(commands, tmp_path / "kept", tmp_path)
    assert list(first) == commands[:1]
    assert f"error: exit code 2: {commands[1]}" in capfd.readouterr().err
    assert run_commands(commands, tmp_path / "kept", tmp_path) == first
