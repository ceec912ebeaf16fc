"""The example that users copy is right, and complete."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest

from vo_service.config import Config, read_config

EXAMPLE = Path(__file__).parents[2] / "config" / "kinect.toml"
TABLES = [field.name for field in dataclasses.fields(Config) if field.name != "synthetic"]


def test_the_example_holds_the_defaults() -> None:
    assert read_config(EXAMPLE) == Config()


@pytest.mark.parametrize("table", TABLES)
def test_the_example_shows_every_key(table: str) -> None:
    text = re.split(r"\n(?:# )?\[", EXAMPLE.read_text().split(f"[{table}]")[1])[0]
    section: Any = getattr(Config(), table)
    keys = {field.name for field in dataclasses.fields(section)}
    assert set(re.findall(r"^(?:# )?(\w+) = ", text, re.MULTILINE)) == keys
