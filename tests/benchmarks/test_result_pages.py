"""Pages of results: their commands run, and the outputs are written into them."""

from pathlib import Path

import pytest

from benchmarks.results import CommandResult, find_commands, run_commands, write_outputs
from drivers.core import InputError

PAGE = """# Speed

```console
$ kinect-vo compare room \\
    --methods direct  # 2026-01-01, abc
old
```

```console
$ kinect-vo --version
```
"""
BENCH = "kinect-vo compare room --methods direct"


def test_commands_are_found_over_several_lines_without_their_comment() -> None:
    assert find_commands(PAGE) == [BENCH, "kinect-vo --version"]


def test_an_output_replaces_the_old_one_and_the_rest_of_the_page_stays() -> None:
    result = CommandResult(BENCH, 0, 1.0, "2026-11-25, def", "new\n")
    expected = PAGE.replace("# 2026-01-01, abc\nold", "# 2026-11-25, def\nnew")
    assert write_outputs(PAGE, [result]) == expected
    assert write_outputs(expected, [result]) == expected


def test_a_failed_command_changes_nothing() -> None:
    for exit_code, output in ((2, "half a table"), (1, "")):
        result = CommandResult(BENCH, exit_code, 1.0, "2026-11-25, def", output)
        assert write_outputs(PAGE, [result]) == PAGE


@pytest.mark.subprocess
def test_a_command_with_a_result_is_not_run_again(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    commands = ["kinect-vo --version", "kinect-vo evaluate room room"]
    results = [run_commands(commands, tmp_path / "kept", tmp_path) for _ in range(2)]
    assert results[0][0] == results[1][0]
    assert [result.exit_code for result in results[0]] == [0, 2]
    assert len((tmp_path / "kept" / "results.jsonl").read_text().splitlines()) == 3


def test_a_damaged_file_of_results_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "results.jsonl").write_text("{")
    with pytest.raises(InputError, match=r"results\.jsonl: cannot read it"):
        run_commands([], tmp_path, tmp_path)
