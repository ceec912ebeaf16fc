"""Parameter sweeps: changed values, rows and the cache."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import direct_sweep
from benchmarks.__main__ import main
from benchmarks.direct_sweep import (
    BASELINE,
    format_row,
    parse_change,
    scale_parameter,
    swept_parameters,
)
from benchmarks.harness import Json
from vo_service.odometry.direct import parameters

GOOD = {"ate_m": 0.00123, "global_m": 0.0045, "lost": 0, "gross": 0}


def test_every_constant_has_another_value_that_can_be_parsed() -> None:
    assert len(swept_parameters()) == len(set(swept_parameters())) > 100
    for name in swept_parameters():
        same, value = parse_change(scale_parameter(name, 2.0))
        assert (same, type(value)) == (name, type(getattr(parameters, name)))
        assert value != getattr(parameters, name)


def test_integers_stay_integers_and_unchanged_values_are_omitted() -> None:
    assert scale_parameter("PLANE_RADIUS_PX", 1.2) == "PLANE_RADIUS_PX=7"
    assert scale_parameter("PLANE_RADIUS_PX", 1.01) == ""
    assert scale_parameter("VELOCITY_SIGMA", 0.5) == "VELOCITY_SIGMA=(0.015, 0.05)"


def test_a_row_has_lost_frames_and_gross_errors() -> None:
    cells = {"a/desk": GOOD, "a/kitchen@5": {**GOOD, "lost": 2, "gross": 1}, "a/wall": None}
    row = " ".join(format_row("SIGMAS=6.0", cells, list(cells)).split())
    assert row == "SIGMAS=6.0 1.23 (4.50) 1.23 (4.50) lost 2 gross 1 -"
    assert "failed: out of memory" in format_row("SIGMAS=6.0", {"failed": "out of memory"}, [])


@pytest.mark.subprocess
def test_constants_are_changed_before_anything_imports_them() -> None:
    look = (
        "import sys, benchmarks.direct_sweep;"
        "print(*(name for name in sys.modules if name.startswith('vo_service.odometry.direct')))"
    )
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [parameters.__name__]


def test_stored_rows_are_not_computed_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[str] = []

    def row(change: str, recordings: list[str]) -> Json:
        made.append(change)
        return dict.fromkeys(recordings, GOOD)

    monkeypatch.setattr(direct_sweep, "run_in_subprocess", row)
    arguments = ["direct_sweep", str(tmp_path / "kept"), "desk", "--of", "SIGMAS=6.0"]
    for _ in range(2):
        assert main(arguments) == 0
    assert made == [BASELINE, "SIGMAS=6.0"]
    assert capsys.readouterr().out.count("SIGMAS=6.0") == 2
