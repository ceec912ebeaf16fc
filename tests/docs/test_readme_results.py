"""The README's table of results has the figures of docs/results/accuracy.md."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
METHODS = {
    "direct": "`direct`",
    "surf": "`surf`",
    "orb-slam3": "ORB-SLAM3",
    "cv2-rgb-depth": "Open",
}
RECORDINGS = ("redkitchen", "room_desk", "room_rolling")


def rows_of(method: str) -> list[list[str]]:
    """The words of a method's rows in the comparison of all methods: errors and times, in turn."""
    text = (ROOT / "docs/results/accuracy.md").read_text()
    block = text.split("$ kinect-vo compare ")[1].split("```")[0]
    return [line.split() for line in block.splitlines() if line.split()[:1] == [method]]


@pytest.mark.parametrize("method", METHODS)
def test_the_figures_are_those_of_the_comparison(method: str) -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    (row,) = (line for line in lines if line.startswith(f"| {METHODS[method]}"))
    *errors, cpu_ms = (cell.strip() for cell in row.strip("|").split("|")[1:])
    rows = rows_of(method)
    for error, words in zip(errors, rows[::2][: len(RECORDINGS)], strict=True):
        ate_mm = float(error.split(";")[0])
        decimals = len(error.split(";")[0].partition(".")[2])
        assert ate_mm == round(float(words[1]), decimals or None)
        lost = re.search(r"(\d+)(?: of \d+)? lost", error)
        assert lost is not None
        assert lost[1] == words[-4]
    assert float(cpu_ms) == float(rows[1][1])
