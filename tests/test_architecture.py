"""ARCHITECTURE.md has a line for each folder, and for each file beside them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("drivers", "vo_service")


def test_every_folder_and_every_file_beside_them_has_one_line() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    table = text.split("## Where everything is")[1].split("## ")[0]
    places = re.findall(r"^\| `([^`|]+)` \|", table, re.MULTILINE)
    assert len(places) == len(set(places))
    assert [place for place in places if not (ROOT / place).exists()] == []
    assert {place for place in places if place.startswith(PACKAGES)} == code_places()


def code_places() -> set[str]:
    files = [file.relative_to(ROOT) for each in PACKAGES for file in (ROOT / each).rglob("*.py")]
    folders = {str(file.parent) for file in files} - set(PACKAGES)
    return folders | {
        str(file) for file in files if len(file.parts) == 2 and file.stem != "__init__"
    }
