"""The README's table of results has the figures of docs/results/accuracy.json."""

import re
from pathlib import Path

import pytest

from benchmarks.result_pages import PAGES, read_results

ROOT = Path(__file__).parents[2]
METHODS = {
    "direct": "`direct`",
    "surf": "`surf`",
    "orb-slam3": "ORB-SLAM3",
    "cv2-rgb-depth": "Open",
}
RECORDINGS = ("redkitchen", "room_desk", "room_rolling")
(COMPARISON,) = (each for each in read_results(PAGES / "accuracy.json") if each.name == "methods")
RESULTS = {
    (row[0], row[1]): dict(zip(COMPARISON.columns, row, strict=True)) for row in COMPARISON.rows
}


@pytest.mark.parametrize("method", METHODS)
def test_the_figures_are_those_of_the_comparison(method: str) -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    (row,) = (line for line in lines if line.startswith(f"| {METHODS[method]}"))
    *errors, cpu_ms = (cell.strip() for cell in row.strip("|").split("|")[1:])
    for recording, error in zip(RECORDINGS, errors, strict=True):
        result, ate = RESULTS[recording, method], error.split(";")[0]
        assert f"{result['ATE mm']:.{len(ate.partition('.')[2])}f}" == ate
        lost = re.search(r"(\d+)(?: of \d+)? lost", error)
        assert lost is not None
        assert int(lost[1]) == result["lost"]
    assert float(cpu_ms) == RESULTS["redkitchen", method]["CPU ms mean"]
