"""The tables that are written from the source."""

from pathlib import Path

import pytest

from scripts.write_reference import parameter_table, replace_tables

SOURCE = '''"""Parameters."""

# IMAGE PYRAMID
# Smallest image, px.
MIN_IMAGE_PX = 12
MAX_IMAGE_PX = 99
# Largest number of failures, and
# time, s.
MAX_FAILURES, MAX_LOST_S = 3, 2e0
'''


def test_a_parameter_has_its_value_as_written_and_the_whole_comment_above_it() -> None:
    assert parameter_table(SOURCE).splitlines()[2:] == [
        "| **Image pyramid** |  |  |",
        "| `MIN_IMAGE_PX` | `12` | Smallest image, px. |",
        "| `MAX_IMAGE_PX` | `99` | see above |",
        "| `MAX_FAILURES` | `3` | Largest number of failures, and time, s. |",
        "| `MAX_LOST_S` | `2e0` | see above |",
    ]


def test_a_page_without_the_place_for_a_table_is_an_error(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("No table.\n")
    with pytest.raises(ValueError, match=r"page\.md: there must be one table parameters"):
        replace_tables(page, {"parameters": ""})
