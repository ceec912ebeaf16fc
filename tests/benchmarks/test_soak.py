"""The samples of a soak test, and its checks for growth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.soak import SoakSample, check_soak, save_plot

FLAT = SoakSample(
    frame=0, service_mb=300.0, others_mb=200.0, handles=40, threads=20,
    children=2, p50_ms=11.0, p99_ms=19.0, cpu_ms=14.0, dropped=0, lost=0,
)  # fmt: skip


def run_of(count: int, mb_per_1000: float = 0.0) -> list[SoakSample]:
    return [
        replace(FLAT, frame=1000 * k, service_mb=300.0 + mb_per_1000 * k)
        for k in range(1, count + 1)
    ]


def failed(samples: Sequence[SoakSample], warm_up: int = 2000) -> list[str]:
    return [each.name for each in check_soak(samples, warm_up) if not each.is_within_limit]


def test_constant_resources_pass() -> None:
    assert failed(run_of(20)) == []


@pytest.mark.parametrize(("mb_per_1000", "is_leak"), [(0.09, False), (0.11, True)])
def test_a_leak_is_one_megabyte_in_ten_thousand_frames(mb_per_1000: float, is_leak: bool) -> None:
    assert ("memory of the service" in failed(run_of(20, mb_per_1000))) is is_leak


def test_growth_during_the_warm_up_is_not_a_leak() -> None:
    cold = [replace(sample, service_mb=100.0) for sample in run_of(2)]
    assert failed([*cold, *run_of(20)[2:]]) == []


def test_handles_latency_and_lost_poses_are_checked() -> None:
    samples = [
        replace(sample, handles=40 + k, p50_ms=11.0 + k, lost=k)
        for k, sample in enumerate(run_of(12))
    ]
    assert {"open handles", "latency, median, end to start", "poses lost in transmission"} <= set(
        failed(samples)
    )


def test_too_few_samples_are_an_error() -> None:
    with pytest.raises(ValueError, match="too few"):
        check_soak(run_of(3), warm_up=2000)


def test_samples_can_be_plotted(tmp_path: Path) -> None:
    picture = tmp_path / "soak.png"
    save_plot(run_of(5), picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
