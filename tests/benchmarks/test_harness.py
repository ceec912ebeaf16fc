"""The harness of the benchmarks: rows of a table, results that are kept, and variants."""

from argparse import Namespace
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.__main__ import find_benchmarks, main
from benchmarks.harness import (
    ResultCache,
    Table,
    combine_runs,
    measure_cpu_ms,
    option,
    run_benchmark,
    run_in_turn,
)
from drivers.core import InputError


@dataclass(frozen=True)
class Run:
    """Figures of a run."""

    cpu_ms: float
    lost: int
    ate_m: float | None


def test_rows_are_aligned_below_their_headings() -> None:
    table = Table(6, "frames:8d", "ATE:8.1f")
    assert table.head == "        frames     ATE"
    assert table.row("desk", 360, 0.58) == "desk       360     0.6"
    assert table.row("room", "all", None) == "room       all       -"


def test_a_column_of_lengths_is_in_millimeters() -> None:
    table = Table(5, "ATE:8.1mm")
    assert table.row("desk", 0.0023) == "desk      2.3"
    assert table.row("room", None) == "room        -"


def test_each_round_runs_every_case_once(capsys: pytest.CaptureFixture[str]) -> None:
    calls: list[str] = []

    def run(name: str) -> int:
        calls.append(name)
        return len(calls)

    results = run_in_turn({name: partial(run, name) for name in ("on", "off")}, 2)
    assert (calls, results) == (["on", "off"] * 2, {"on": [1, 3], "off": [2, 4]})
    assert capsys.readouterr().err.splitlines()[-1] == "round 2 of 2: off"


def test_runs_are_combined_to_their_known_medians() -> None:
    runs = [Run(2.0, 1, 0.1), Run(9.0, 0, None), Run(3.0, 2, 0.3)]
    assert combine_runs(runs, lost=sum) == Run(3.0, 3, 0.2)
    assert combine_runs([Run(1.0, 0, None)]).ate_m is None


def test_work_is_measured_in_milliseconds_of_the_given_clock() -> None:
    times_s = iter([1.0, 1.25])
    assert measure_cpu_ms(lambda: "done", lambda: next(times_s)) == ("done", 250.0)


def test_a_kept_result_is_not_measured_again(tmp_path: Path) -> None:
    ResultCache(tmp_path).get_or_run("desk", lambda: {"ate_m": 0.1})
    again = ResultCache(tmp_path)
    assert "desk" in again
    assert again.get_or_run("desk", lambda: pytest.fail("measured again")) == {"ate_m": 0.1}


@pytest.mark.parametrize(
    ("text", "message"),
    [("[1]", "has no results; name another folder"), ("thesis", "cannot read it")],
)
def test_a_file_of_another_kind_is_not_overwritten(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(InputError, match=message):
        ResultCache(tmp_path)
    assert (tmp_path / "results.json").read_text() == text


def test_the_named_variant_runs_with_its_options() -> None:
    @option("--count")
    def main(args: Namespace) -> int:
        """Measure."""
        return int(args.count)

    module = ModuleType("example", "An example.")
    module.__dict__["VARIANTS"] = {"one": main}
    assert run_benchmark("example", module, ["one", "--count", "3"]) == 3
    with pytest.raises(SystemExit):
        run_benchmark("example", module, ["two"])


@pytest.mark.parametrize("name", find_benchmarks())
def test_every_benchmark_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    assert f"python -m benchmarks {name}" in capsys.readouterr().out
