"""``kinect-vo config``: check a configuration file, or print the configuration reference."""

import dataclasses
import json
import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args, get_origin

from drivers.core import InputError, UserFacingError
from drivers.core.config import (
    SCHEMA_VERSION,
    Field,
    FieldError,
    TypedField,
    read_toml,
    typed_fields,
)
from drivers.core.files import check_suffix, check_writable
from drivers.core.folders import state_folder
from drivers.core.geometry import read_trajectory
from drivers.core.write_errors import check_output_file
from vo_service.cli.request import CommandRequest, argument
from vo_service.config import CameraConfig, Config
from vo_service.config_tables import RecorderConfig, RerunConfig

logger = logging.getLogger(__name__)


EPILOG = """\
examples:
  kinect-vo config check /etc/kinect-vo/kinect.toml
  kinect-vo config reference | less

An error names its file, line and key; the exit code is then 2. The check includes the files and
addresses that the configuration names, without opening them: the camera file, Rerun targets, Zenoh
endpoints, and the Zenoh configuration with its keys and rules. A map of map.load that cannot be
loaded is a warning; it is looked for where a service of this user has its maps.
"""


@dataclass(frozen=True, kw_only=True)
class CheckConfigRequest(CommandRequest):
    """Check a file, and the files and addresses in it."""

    file: Path = argument("configuration file (TOML)", "FILE")


@dataclass(frozen=True, kw_only=True)
class ConfigReferenceRequest(CommandRequest):
    """Print every key with its meaning (Markdown)."""


ACTIONS = {"check": CheckConfigRequest, "reference": ConfigReferenceRequest}


def run(request: CheckConfigRequest | ConfigReferenceRequest) -> int:
    """Check or print."""
    if isinstance(request, ConfigReferenceRequest):
        print(render_reference(), end="")
        return 0
    for warning in check_config(request.file):
        logger.warning("%s", warning)
    print(f"{request.file}: no mistakes")
    return 0


def check_config(path: Path) -> list[str]:
    """Read a configuration file, and check the files and addresses in it.

    Relative paths start at the current folder, as for `run`.

    Returns:
        Warnings about settings that are allowed but dangerous.

    Raises:
        InputError: For the first mistake, with the file.
    """
    warnings: list[str] = []
    read_toml(path, Config, lambda config: warnings.extend(_check_parts(config)))
    return warnings


def _check_parts(config: Config) -> Iterator[str]:
    """Check the files and addresses of a configuration, and yield warnings. Raises FieldError."""
    from vo_service.outputs.zenoh.session_check import check_session_config

    _check_camera(config.camera)
    _check_rerun(config.rerun)
    if config.has_recorder:
        _check_recorder(config.recorder)
    if config.synthetic.track is not None:
        with _errors_of("synthetic", "track"):
            read_trajectory(config.synthetic.track)
    if config.outputs.mcap is not None:
        with _errors_of("outputs", "mcap"):
            check_suffix(config.outputs.mcap, [".mcap"])
            check_output_file(config.outputs.mcap)
    if config.map.enabled and config.map.load is not None:
        if config.map.loop_closure:
            yield from _check_map(config.map.load)
        else:
            yield "map.load: no map is loaded with map.loop_closure = false"
    with _errors_of("zenoh", "config_file" if config.zenoh.config_file else "listen"):
        warning = check_session_config(config.zenoh)
    if warning:
        yield warning


@contextmanager
def _errors_of(*path: str) -> Iterator[None]:
    """Raise an InputError of the block as one of a key."""
    try:
        yield
    except FieldError:
        raise
    except InputError as error:
        raise FieldError(path, str(error)) from error


def _check_camera(camera: CameraConfig) -> None:
    kind, _, argument = camera.source.partition(":")
    if camera.file is not None and kind == "synthetic":
        raise FieldError(
            ("camera", "file"), "the virtual Kinect has its own calibration; leave it out"
        )
    if camera.file is not None:
        from drivers.calibration import read_calibration

        with _errors_of("camera", "file"):
            read_calibration(camera.file)
    is_recording = kind in ("tum", "bag", "fakenect") or argument.endswith(".oni")
    if is_recording and not (argument and Path(argument).exists()):
        missing = "folder" if kind in ("tum", "fakenect") else "file"
        raise FieldError(("camera", "source"), f"{argument}: no such {missing}; check the path")


def _check_rerun(rerun: RerunConfig) -> None:
    from vo_service.outputs.rerun.targets import check_targets

    with _errors_of("rerun", "targets"):
        check_targets(rerun.targets)
        for target in rerun.targets:
            folder = Path(target).parent
            if target.endswith(".rrd") and not folder.is_dir():
                raise InputError(
                    f"{target}: cannot be written: there is no folder {folder}; create it first"
                )
        if rerun.targets and find_spec("rerun") is None:
            raise InputError("Rerun is not installed: pip install 'kinect-vo[rerun]'")


def _check_recorder(recorder: RecorderConfig) -> None:
    if recorder.folder is None:
        return
    reason = check_writable(recorder.folder)
    if reason:
        raise FieldError(("recorder", "folder"), f"{reason}; name a writable folder")


def _check_map(name: str) -> Iterator[str]:
    """Yield a warning if the map cannot be loaded: the service then starts with an empty one."""
    from vo_service.slam.map_file import read_map
    from vo_service.slam.mapper.map_store import MapStore

    try:
        read_map(MapStore(state_folder() / "maps").map_file(name))
    except UserFacingError as error:
        yield f"map: {error}"


REFERENCE_COMMAND = "kinect-vo config reference"
INTRODUCTION = f"""\
# Configuration

Every key of the file that `kinect-vo run --config FILE` reads, with its default;
[config/kinect.toml](../../config/kinect.toml) is such a file. `{REFERENCE_COMMAND}` writes this
page.

The file is TOML and begins with `schema = {SCHEMA_VERSION}`. Every table and every key below is
optional, except those marked *required*. An unknown key, or a value of a wrong type or out of
range, is refused with its file, line and reason. `kinect-vo config check FILE` checks a file
without starting the service.

The column "after reload" shows when a change takes effect after a running service has read its
file again (`systemctl reload kinect-vo`, or SIGHUP): at once, or at the next start.
"""
SYNTHETIC_DESCRIPTION = """\
For `camera.source = "synthetic"`. Without this table, a short sequence is rendered quickly
(`duration_s = 10.0`, `texel_m = 0.004`, neither lens distortion nor motion blur) and repeated
(`loop = true`). With this table, missing keys have the defaults below."""
# Descriptions of tables that replace the docstring of the class.
TABLE_DESCRIPTIONS = {
    "synthetic": SYNTHETIC_DESCRIPTION,
    "synthetic.camera": "Intrinsics of both images, all of them.",
}
TABLE_HEADER = (
    "| key | type | default | range | meaning | after reload |\n|---|---|---|---|---|---|\n"
)


def render_reference() -> str:
    """Render the page, with the tables in the order of `Config`."""
    return INTRODUCTION + "".join(_render_table(key.kind, key.name) for key in typed_fields(Config))


def _render_table(kind: Any, path: str, brackets: str = "[{}]") -> str:
    """Render a table's section, then those of the tables inside it."""
    heading = f"\n## `{brackets.format(path)}`\n\n{_table_description(kind, path)}\n\n"
    rows, inner = "", ""
    for key in typed_fields(kind):
        below = f"{path}.{key.name}"
        if dataclasses.is_dataclass(key.kind):
            inner += _render_table(key.kind, below)
        elif dataclasses.is_dataclass(_item_type(key.kind)):
            inner += _render_table(_item_type(key.kind), below, "[[{}]]")
        else:
            rows += _render_row(key)
    return heading + TABLE_HEADER + rows + inner


def _table_description(kind: Any, path: str) -> str:
    """First paragraph of the class's docstring, without the table's name."""
    if path in TABLE_DESCRIPTIONS:
        return TABLE_DESCRIPTIONS[path]
    paragraph = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
    text = paragraph.removeprefix(f"`[{path}]`: ").split(" Raises ")[0]
    return text[:1].upper() + text[1:]


def _render_row(key: TypedField) -> str:
    effect = "at once" if key.spec.is_reloadable else "next start"
    cells = (
        f"`{key.name}`",
        format_type(key.kind),
        "*required*" if key.is_required else _format_value(key.default),
        _format_range(key.spec),
        key.spec.description,
        effect,
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def format_type(kind: Any) -> str:
    """Name a type in plain English."""
    if get_origin(kind) in (list, tuple):
        items = get_args(kind)
        one = format_type(items[0])
        return f"list of {one}" if items[-1] is ... else f"list of {len(items)} × {one}"
    if issubclass(kind, StrEnum):
        return ", ".join(f'`"{choice}"`' for choice in kind)
    names = {bool: "true or false", int: "whole number", float: "number", Path: "path", str: "text"}
    return names[kind]


def _format_range(spec: Field) -> str:
    low, high = spec.minimum, spec.maximum
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.15g} to {high:.15g}"
    return spec.range_text


def _format_value(value: Any) -> str:
    """Format a value as in TOML."""
    if value is None:
        return "unset"
    listed = list(value) if isinstance(value, tuple) else value
    return f"`{json.dumps(listed, default=str)}`"


def _item_type(kind: Any) -> Any:
    """Type of a list's items; None if `kind` is not a list."""
    return get_args(kind)[0] if get_origin(kind) in (list, tuple) else None
