"""The configuration that runs were made with, as a file."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from drivers.core.config import SCHEMA_VERSION
from vo_service.config import OdometryConfig


def format_effective_config(
    odometry: OdometryConfig,
    camera_file: Path | None,
    tables: Mapping[str, Mapping[str, object]],
    *notes: str,
) -> str:
    """Text that `--config` takes again, with other tables; the notes stand above as comments."""
    camera = [] if camera_file is None else _format_table("camera", {"file": camera_file})
    about = "What the methods ran with; everything else was at its default, or is not used."
    comments = [f"# {note}" for note in (about, *notes)]
    odometry_lines = _format_table("odometry", asdict(odometry))
    others = [line for name, values in tables.items() for line in _format_table(name, values)]
    lines = [*comments, f"schema = {SCHEMA_VERSION}", *camera, *odometry_lines, *others]
    return "\n".join(lines) + "\n"


def _format_table(name: str, values: Mapping[str, object]) -> list[str]:
    """A table of TOML; JSON's texts, numbers and lists are TOML's too."""
    keys = [
        f"{key} = {json.dumps(value, default=str, ensure_ascii=False)}"
        for key, value in values.items()
        if value is not None
    ]
    return ["", f"[{name}]", *keys]
