"""Settings and versions of a comparison for its report."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vo_service.config import Config
from vo_service.tools.benchmark.method_factory import SfmScale
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.report.effective_config import format_effective_config
from vo_service.tools.benchmark.versions import collect_versions


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
