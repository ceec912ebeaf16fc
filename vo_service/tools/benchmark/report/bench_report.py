"""Files of the bench: all metrics for scripts, and the settings."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vo_service.config import OdometryConfig
from vo_service.tools.benchmark.baselines.registry import BASELINE_NAMES, find_package
from vo_service.tools.benchmark.methods import UnavailableMethods
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.report.bench_tables import (
    RelativeResults,
    bench_table,
    metric_ratios,
    metric_values,
)
from vo_service.tools.benchmark.report.metadata import format_effective_config
from vo_service.tools.benchmark.run_cache import write_file
from vo_service.tools.benchmark.versions import collect_versions

DATA_FILE, TABLE_FILE, CONFIG_FILE = "report.json", "bench.csv", "config.toml"


@dataclass(frozen=True)
class BenchMetadata:
    """Settings of a bench.

    Attributes:
        methods: Methods that run, in order.
        unavailable: Requested methods that are not installed.
        reference_method: Baseline for relative figures.
        frame_steps: Every n-th frame is used, with one pass over the recordings for each n.
        max_frames: Number of first frames of each recording to use; None for all.
        odometry: Settings of our methods.
        camera_file: Camera file for all recordings; None for each recording's own.
        time_limit_s: Time limit of each run.
        observer_factory: Made the observer of each run.
        orb_vocabulary: Vocabulary of ORB-SLAM3; "" if it does not run.
        created: Time of the bench.
    """

    methods: Sequence[str]
    unavailable: Sequence[UnavailableMethods]
    reference_method: str
    frame_steps: Sequence[int]
    max_frames: int | None
    odometry: OdometryConfig
    camera_file: Path | None
    time_limit_s: float
    observer_factory: ObserverFactory = NULL_OBSERVER
    orb_vocabulary: str = ""
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    def as_json(self) -> dict[str, Any]:
        """Return the settings and versions for report.json."""
        packages = {find_package(name) for name in self.methods if name in BASELINE_NAMES}
        baselines = {package.pip_names[0]: package.version for package in packages}
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "left_out": [each.as_json() for each in self.unavailable],
            "against": self.reference_method,
            "every": list(self.frame_steps),
            "first_frames": self.max_frames,
            "odometry": asdict(self.odometry),
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.observer_factory.settings,
            "orb_vocabulary": self.orb_vocabulary or None,
            "versions": {**collect_versions(), **dict(sorted(baselines.items()))},
            "processors": os.cpu_count(),
        }


def report_content(metadata: BenchMetadata, results: Sequence[RelativeResults]) -> dict[str, Any]:
    """Return the whole content of report.json."""
    return {"schema": 1, **metadata.as_json(), "results": [_as_json(each) for each in results]}


def _as_json(results: RelativeResults) -> dict[str, Any]:
    """Return one recording at one frame step, with the metrics of comparison and bench."""
    content = results.results.as_json()
    recording = results.results.recording
    methods = {
        method: {
            **content["methods"][method],
            **metric_values(evaluation),
            "ratios": metric_ratios(evaluation, results.reference_evaluation),
        }
        for method, evaluation in results.results.evaluations.items()
    }
    name = recording.folder.resolve().name
    return {**content, "name": name, "every": recording.frame_selection.step, "methods": methods}


def write_bench_report(
    folder: Path, metadata: BenchMetadata, results: Sequence[RelativeResults]
) -> None:
    """Write the files, report.json last. Raises InputError or UserFacingError as `write_file`.

    Args:
        folder: Folder of the report.
        metadata: Settings of the bench.
        results: Results by recording and frame step.
    """
    notes = (
        f"Methods: {', '.join(metadata.methods)}; `method` below applies to runs of the service.",
        f"--every {' '.join(map(str, metadata.frame_steps))}"
        + ("" if metadata.max_frames is None else f" --frames {metadata.max_frames}"),
    )
    config = format_effective_config(
        metadata.odometry, metadata.camera_file, metadata.observer_factory.config_tables, *notes
    )
    write_file(folder / CONFIG_FILE, config.encode())
    write_file(folder / TABLE_FILE, bench_table(results).as_csv().encode())
    text = json.dumps(report_content(metadata, results), indent=2)
    write_file(folder / DATA_FILE, f"{text}\n".encode())
