"""Settings and versions of a comparison for its report, and the configuration as a file."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.core.config import SCHEMA_VERSION
from vo_service.config import Config, OdometryConfig
from vo_service.tools.benchmark import collect_versions
from vo_service.tools.benchmark.methods import SfmScale
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory


def format_effective_config(
    odometry: OdometryConfig,
    camera_file: Path | None,
    tables: Mapping[str, Mapping[str, object]],
    *notes: str,
) -> str:
    """Format a configuration for `--config`.

    Args:
        odometry: The table `[odometry]`.
        camera_file: Camera file; None if not given.
        tables: Additional tables by name.
        *notes: Comments at the top.
    """
    camera = [] if camera_file is None else _format_table("camera", {"file": camera_file})
    summary = "Settings of the methods; all other settings have default values or are not used."
    comments = [f"# {note}" for note in (summary, *notes)]
    odometry_lines = _format_table("odometry", asdict(odometry))
    other_lines = [line for name, values in tables.items() for line in _format_table(name, values)]
    lines = [*comments, f"schema = {SCHEMA_VERSION}", *camera, *odometry_lines, *other_lines]
    return "\n".join(lines) + "\n"


def _format_table(name: str, values: Mapping[str, object]) -> list[str]:
    """Format a TOML table; texts, numbers and lists are written as in JSON."""
    keys = [
        f"{key} = {json.dumps(value, default=str, ensure_ascii=False)}"
        for key, value in values.items()
        if value is not None
    ]
    return ["", f"[{name}]", *keys]


@dataclass(frozen=True)
class ComparisonMetadata:
    """Settings of a comparison.

    Attributes:
        methods: Methods that run, in order.
        config: Configuration of our methods.
        sfm_scale: Source of the first scale of `sfm`.
        camera_file: Camera file for all recordings; None for each recording's own.
        time_limit_s: Time limit of each run.
        observer_factory: Made the observer of each run.
        created: Time of the comparison.
    """

    methods: Sequence[str]
    config: Config
    sfm_scale: SfmScale
    camera_file: Path | None
    time_limit_s: float
    observer_factory: ObserverFactory = NULL_OBSERVER
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def config_text(self) -> str:
        """The effective configuration, in the format of `--config`."""
        return format_effective_config(
            self.config.odometry,
            self.camera_file,
            self.observer_factory.config_tables,
            f"Methods: {', '.join(self.methods)}; `method` below applies to runs of the service.",
            f"First scale of sfm: --sfm-scale {self.sfm_scale}",
        )

    def as_json(self) -> dict[str, Any]:
        """Return the settings and versions for report.json."""
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "odometry": asdict(self.config.odometry),
            "sfm_scale": self.sfm_scale,
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.observer_factory.settings,
            "versions": collect_versions(),
            "processors": os.cpu_count(),
        }
