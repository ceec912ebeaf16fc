"""The record of a soak test, and its checks for growth."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.soak import SoakRecord, SoakSample, check_soak, save_plot, slope

FLAT = SoakSample(
    run=0, frame=0, service_mb=300.0, others_mb=200.0, handles=40, threads=20,
    children=2, p50_ms=11.0, p99_ms=19.0, cpu_ms=14.0, dropped=0, lost=0,
)  # fmt: skip


def record_of(file: Path, *samples: SoakSample) -> SoakRecord:
    record = SoakRecord(file)
    for sample in samples:
        record.add(sample)
    return record


def run_of(
    count: int, run: int = 0, mb_per_1000: float = 0.0, base_mb: float = 300.0
) -> list[SoakSample]:
    return [
        replace(FLAT, run=run, frame=1000 * k, service_mb=base_mb + mb_per_1000 * k)
        for k in range(1, count + 1)
    ]


def failed(record: SoakRecord, warm_up: int = 2000) -> list[str]:
    return [each.name for each in check_soak(record, warm_up) if not each.is_within_limit]


def test_a_record_is_continued(tmp_path: Path) -> None:
    file = tmp_path / "state.json"
    before = record_of(file, *run_of(4))
    again = SoakRecord.load(file)
    assert again.samples == before.samples
    for sample in run_of(3, run=again.runs):
        again.add(sample)
    assert (SoakRecord.load(file).runs, SoakRecord.load(file).frames) == (2, 7000)


def test_constant_resources_pass(tmp_path: Path) -> None:
    assert failed(record_of(tmp_path / "state.json", *run_of(20))) == []


@pytest.mark.parametrize(("mb_per_1000", "is_leak"), [(0.09, False), (0.11, True)])
def test_a_leak_is_one_megabyte_in_ten_thousand_frames(
    tmp_path: Path, mb_per_1000: float, is_leak: bool
) -> None:
    record = record_of(tmp_path / "state.json", *run_of(20, mb_per_1000=mb_per_1000))
    assert ("memory of the service" in failed(record)) is is_leak


def test_each_run_has_its_own_offset(tmp_path: Path) -> None:
    runs = run_of(10) + run_of(10, run=1, base_mb=350.0)
    assert slope(runs, "service_mb") == pytest.approx(0.0, abs=1e-9)


def test_growth_during_the_warm_up_is_not_a_leak(tmp_path: Path) -> None:
    cold = [replace(sample, service_mb=100.0) for sample in run_of(2)]
    assert failed(record_of(tmp_path / "state.json", *cold, *run_of(20)[2:])) == []


def test_handles_latency_and_lost_poses_are_checked(tmp_path: Path) -> None:
    samples = [
        replace(sample, handles=40 + k, p50_ms=11.0 + k, lost=k)
        for k, sample in enumerate(run_of(12))
    ]
    assert {"open handles", "latency, median, end to start", "poses lost in transmission"} <= set(
        failed(record_of(tmp_path / "state.json", *samples))
    )


def test_too_few_samples_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="too few"):
        check_soak(record_of(tmp_path / "state.json", *run_of(3)), warm_up=2000)


def test_a_record_can_be_plotted(tmp_path: Path) -> None:
    picture = tmp_path / "soak.png"
    save_plot(record_of(tmp_path / "state.json", *run_of(5), *run_of(5, run=1)), picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
