"""The page of all configuration keys says what the code says."""

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tests.vo_service.cli.cli_runner import run_in_process
from vo_service.cli.config import REFERENCE_COMMAND, render_reference
from vo_service.config import RELOADABLE_KEYS, Config, read_config

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "configuration.md"


def rows() -> dict[str, list[str]]:
    """The cells of every key, by its whole name."""
    found, table = {}, ""
    for line in render_reference().splitlines():
        heading = re.fullmatch(r"## `\[{1,2}([\w.]+)\]{1,2}`", line)
        table = heading[1] if heading else table
        if line.startswith("| `"):
            cells = [
                cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]
            ]
            found[f"{table}.{cells[0].strip('`')}"] = cells
    return found


def keys(kind: Any, path: str = "") -> set[str]:
    """Of all tables that are not lists."""
    found = set()
    for field in dataclasses.fields(kind):
        value, name = getattr(kind, field.name), f"{path}{field.name}"
        found |= keys(value, f"{name}.") if dataclasses.is_dataclass(value) else {name}
    return found


def test_the_page_matches_the_code() -> None:
    assert PAGE.read_text() == render_reference(), (
        f"run: {REFERENCE_COMMAND} > docs/reference/configuration.md"
    )


@pytest.mark.parametrize("key", sorted(rows()))
def test_every_key_has_a_description(key: str) -> None:
    assert len(rows()[key][4].split()) >= 2


def test_the_defaults_on_the_page_can_be_parsed(tmp_path: Path) -> None:
    lines = ["schema = 1"]
    for key, (_, _, default, *_) in rows().items():
        if default.startswith("`") and not key.startswith("synthetic"):
            lines.append(f"{key} = {default.strip('`')}")
    file = tmp_path / "kinect.toml"
    file.write_text("\n".join(lines))
    assert len(tomllib.loads(file.read_text())) > 8
    assert read_config(file) == Config()


def test_live_keys_are_marked() -> None:
    assert {key for key, cells in rows().items() if cells[5] == "at once"} == set(RELOADABLE_KEYS)


def test_types_and_ranges_are_described() -> None:
    assert rows()["sensor.tilt_deg"][1:4] == ["number", "unset", "-31 to 31"]
    assert rows()["rerun.files_kept"][1:4] == ["whole number", "`4`", "at least 1"]
    assert rows()["T_base_camera.translation_m"][1] == "list of 3 × number"
    assert rows()["synthetic.faults.first"][2] == "*required*"


def test_the_command_prints_the_page(capfd: pytest.CaptureFixture[str]) -> None:
    ended = run_in_process(capfd, "config", "reference")
    assert (ended.code, ended.out) == (0, render_reference())
