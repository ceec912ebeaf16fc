"""The odometry of wheels in a folder."""

from pathlib import Path

import pytest

from drivers.core import InputError
from drivers.tum.odometry import ODOMETRY_FILE, format_message, read_odometry


def test_messages_are_read_back_bit_for_bit(tmp_path: Path) -> None:
    assert list(read_odometry(tmp_path)) == []
    messages = [bytes(range(256)), b"\x00\x01\x00\x00"]
    lines = [f"{number}.5 {format_message(each)}\n" for number, each in enumerate(messages)]
    (tmp_path / ODOMETRY_FILE).write_text("".join(lines))
    assert list(read_odometry(tmp_path)) == messages


@pytest.mark.parametrize("line", ["1.5 AAE", "1.5 ====", "1.5 né", "1.5", "1.5 AAE= 7"])
def test_a_wrong_line_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "wheel_odom.txt").write_text(f"# timestamp message\n1.0 AAE=\n{line}\n")
    with pytest.raises(InputError, match=r"wheel_odom.txt:3: "):
        list(read_odometry(tmp_path))
