"""Configuration of the runs as a file."""

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
