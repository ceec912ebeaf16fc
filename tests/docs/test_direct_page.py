"""The page of the direct method names what the code has."""

import re

from tests.docs.blocks import ROOT

PAGE = (ROOT / "docs" / "design" / "direct.md").read_text()
SYMBOLS = PAGE.partition("### Symbols\n")[2].partition("\n## ")[0]


def test_names_beside_the_symbols_are_those_of_the_code() -> None:
    source = "".join(
        file.read_text() for file in (ROOT / "vo_service/odometry/direct").glob("*.py")
    )
    code = " ".join(row.split("|")[3] for row in SYMBOLS.splitlines() if row.startswith("|"))
    names = set(re.findall(r"[A-Za-z]\w+", " ".join(re.findall(r"`([^`]+)`", code))))
    assert len(names) > 30
    assert [name for name in sorted(names) if not re.search(rf"\b{name}\b", source)] == []
