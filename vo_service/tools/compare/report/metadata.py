"""Settings and versions of a comparison, for its report."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.core.config import SCHEMA_VERSION
from vo_service.config import OdometryConfig
from vo_service.tools.compare.baselines.registry import BASELINES
from vo_service.tools.compare.methods import SfmScale, UnavailableMethods
from vo_service.tools.compare.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.compare.versions import collect_versions


@dataclass(frozen=True)
class ReportMetadata:
    """Settings of a comparison.

    Attributes:
        methods: Methods that run, in order.
        odometry: Settings of our methods.
        unavailable: Requested methods that are not installed.
        reference_method: Baseline for relative figures; None without.
        frame_steps: Every n-th frame is used, with one pass over the recordings for each n.
        max_frames: Number of first frames of each recording to use; None for all.
        orb_vocabulary: Vocabulary of ORB-SLAM3; None if it does not run.
        camera_file: Camera file for all recordings; None for each recording's own.
    """

    methods: Sequence[str]
    odometry: OdometryConfig
    time_limit_s: float
    unavailable: Sequence[UnavailableMethods] = ()
    reference_method: str | None = None
    frame_steps: Sequence[int] = (1,)
    max_frames: int | None = None
    sfm_scale: SfmScale = SfmScale.FIRST_DEPTH
    orb_vocabulary: str | None = None
    camera_file: Path | None = None
    observer_factory: ObserverFactory = NULL_OBSERVER
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def versions(self) -> dict[str, str]:
        """Versions by name, also of the baselines' packages."""
        packages = {BASELINES[name] for name in self.methods if name in BASELINES}
        baselines = {package.pip_names[0]: package.version for package in packages}
        return {**collect_versions(), **dict(sorted(baselines.items()))}

    @property
    def config_text(self) -> str:
        """The effective configuration, in the format of `--config`; options are comments."""
        frames = "" if self.max_frames is None else f" --frames {self.max_frames}"
        tables: dict[str, Mapping[str, object]] = {
            "camera": {"file": self.camera_file},
            "odometry": asdict(self.odometry),
            **self.observer_factory.config_tables,
        }
        lines = [
            "# Settings of the methods; all other settings have default values or are not used.",
            f"# Methods: {', '.join(self.methods)}; `method` below applies to runs of the service.",
            f"# --every {' '.join(map(str, self.frame_steps))}{frames}",
            f"# First scale of sfm: --sfm-scale {self.sfm_scale}",
            f"schema = {SCHEMA_VERSION}",
            *(line for name, values in tables.items() for line in _format_table(name, values)),
        ]
        return "\n".join(lines) + "\n"

    def as_json(self) -> dict[str, Any]:
        """Return the settings and versions for report.json."""
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "left_out": [
                {"methods": list(each.methods), "install": each.package.install_command}
                for each in self.unavailable
            ],
            "against": self.reference_method,
            "every": list(self.frame_steps),
            "first_frames": self.max_frames,
            "odometry": asdict(self.odometry),
            "sfm_scale": self.sfm_scale,
            "orb_vocabulary": self.orb_vocabulary,
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.observer_factory.settings,
            "versions": self.versions,
            "processors": os.cpu_count(),
        }


def _format_table(name: str, values: Mapping[str, object]) -> Iterator[str]:
    """Format a TOML table of JSON values; an empty one is left out."""
    known = {key: value for key, value in values.items() if value is not None}
    if known:
        yield from ("", f"[{name}]")
    for key, value in known.items():
        yield f"{key} = {json.dumps(value, default=str, ensure_ascii=False)}"
