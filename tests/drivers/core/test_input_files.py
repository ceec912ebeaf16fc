"""Only regular files are opened, and their text may be in UTF-8 or UTF-16."""

import os
import socket
from pathlib import Path

import pytest

from drivers.core import InputError
from drivers.core.geometry import read_trajectory
from drivers.core.input_files import open_input, read_input_text


@pytest.mark.parametrize(
    ("name", "kind"),
    [("pipe", "a pipe"), ("folder", "a folder"), ("link", "a device"), ("socket", "a socket")],
)
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, name: str, kind: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        with pytest.raises(OSError, match=f"it is {kind}, not a file"):
            open_input(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_a_text_of_windows_is_read(tmp_path: Path, encoding: str, newline: str) -> None:
    file = tmp_path / "poses.txt"
    file.write_bytes(f"# \u00e9{newline}1 0 0 0 0 0 0 1{newline}".encode(encoding))
    assert read_input_text(file, "") == "# \u00e9\n1 0 0 0 0 0 0 1\n"
    assert len(read_trajectory(file)) == 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"one\ntwo \xe9\n", "FILE:2: is not UTF-8 text (invalid continuation byte); do it"),
        (b"\xff\xfeo", "FILE:1: is not UTF-8 text (truncated data); do it"),
        (b"123456789 too long", "FILE: has more than 16 bytes; do it"),
    ],
)
def test_another_text_is_refused_with_its_line(tmp_path: Path, data: bytes, message: str) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_input_text(file, "do it", max_bytes=16)
    assert str(caught.value).replace(str(file), "FILE") == message
