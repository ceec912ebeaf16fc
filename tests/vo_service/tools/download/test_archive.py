"""Unpacking of untrusted archives."""

import gzip
import os
import tarfile
from contextlib import suppress
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drivers.core import UserFacingError
from tests.full_disk import limit_file_size
from tests.vo_service.tools.download.web_server import (
    make_file_member,
    make_special_member,
    make_tgz,
)
from vo_service.tools.download import sequence_download as archive_module
from vo_service.tools.download.sequence_download import (
    DamagedArchiveError,
    UnsafeArchiveError,
    safe_path,
    unpack,
)

NAMES = st.text(st.sampled_from("./\\ab~é\n\udc80 "), max_size=12)


def unpack_data(data: bytes, tmp_path: Path) -> Path:
    """Unpack into `tmp_path`/in; the only other file is `tmp_path`/archive."""
    archive = tmp_path / "archive"
    archive.write_bytes(data)
    unpack(archive, tmp_path / "in", lambda done, total: None)
    return tmp_path / "in"


def test_files_and_folders_are_unpacked_without_owner_and_mode(tmp_path: Path) -> None:
    member, content = make_file_member("a/b/c.txt", b"hello")
    member.mode, member.uid = 0o7777, 12345
    folder = unpack_data(
        make_tgz(make_special_member("./a", tarfile.DIRTYPE), (member, content)), tmp_path
    )
    assert (folder / "a/b/c.txt").read_bytes() == b"hello"
    state = (folder / "a/b/c.txt").stat()
    assert (state.st_mode & 0o7111, state.st_uid) == (0, os.getuid())


@pytest.mark.parametrize("name", ["../up", "a/../../up", "/etc/up", "a/../b", "..", "//up"])
def test_a_path_outside_is_rejected(tmp_path: Path, name: str) -> None:
    with pytest.raises(UnsafeArchiveError, match="outside its folder"):
        unpack_data(make_tgz(make_file_member(name)), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["archive", "in"]


@pytest.mark.parametrize(
    ("kind", "target"),
    [(tarfile.SYMTYPE, "/etc"), (tarfile.SYMTYPE, "b"), (tarfile.LNKTYPE, "../archive"),
     (tarfile.CHRTYPE, ""), (tarfile.BLKTYPE, ""), (tarfile.FIFOTYPE, ""), (b"Z", "")],
)  # fmt: skip
def test_links_devices_and_unknown_types_are_rejected(
    tmp_path: Path, kind: bytes, target: str
) -> None:
    with pytest.raises(UnsafeArchiveError, match="neither a file nor a folder"):
        unpack_data(
            make_tgz(make_special_member("a", kind, target), make_file_member("a/inside")), tmp_path
        )
    assert list((tmp_path / "in").iterdir()) == []


@pytest.mark.parametrize("second", ["a", "a/b", "./a"])
def test_a_repeated_name_is_rejected(tmp_path: Path, second: str) -> None:
    with pytest.raises(UnsafeArchiveError, match="twice"):
        unpack_data(make_tgz(make_file_member("a"), make_file_member(second)), tmp_path)


@given(name=NAMES)
@example(name="..\udc80/a")
def test_an_accepted_path_is_below_the_folder(name: str) -> None:
    try:
        path = safe_path(name)
    except UnsafeArchiveError:
        return
    assert os.path.normpath(PurePosixPath("/root") / path).startswith("/root")
    assert ".." not in path.parts


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.lists(NAMES.filter(bool), min_size=1, max_size=3))
def test_nothing_is_written_outside(
    names: list[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    parent = tmp_path_factory.mktemp("names")
    try:
        folder = unpack_data(make_tgz(*(make_file_member(name) for name in names)), parent)
    except UserFacingError:
        folder = parent / "in"
    assert {path.name for path in parent.iterdir()} == {"archive", "in"}
    assert all(folder in path.parents for path in folder.rglob("*"))


def tar(*members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    return gzip.decompress(make_tgz(*members))


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 3 * 512 - 1), byte=st.integers(0, 255), fixes_checksum=st.booleans())
def test_a_changed_header_is_damaged_unsafe_or_another_file(
    at: int, byte: int, fixes_checksum: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Change any byte of two headers, with and without a correct checksum."""
    data = bytearray(tar(make_file_member("a" * 101, b"y" * 512)))
    data[at] = byte
    for start in (0, 1024) if fixes_checksum else ():
        header = data[start : start + 512]
        header[148:156] = b" " * 8
        data[start + 148 : start + 156] = b"%06o\0 " % sum(header)
    parent = tmp_path_factory.mktemp("changed")
    with suppress(DamagedArchiveError, UnsafeArchiveError):
        unpack_data(gzip.compress(bytes(data)), parent)
    assert {path.name for path in parent.iterdir()} == {"archive", "in"}


def test_an_overwritten_header_in_the_middle_is_damage(tmp_path: Path) -> None:
    data = tar(make_file_member("a", b"1" * 512), make_file_member("b", b"2" * 512))
    with pytest.raises(DamagedArchiveError, match="a header cannot be read"):
        unpack_data(gzip.compress(data[:1024] + b"?" * 512 + data[1536:]), tmp_path)


def test_an_archive_that_would_fill_the_disk_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive_module, "MIN_SIZE_LIMIT_BYTES", 1 << 18)
    with pytest.raises(UnsafeArchiveError, match="once unpacked"):
        unpack_data(make_tgz(make_file_member("a", bytes(1 << 20))), tmp_path)
    assert sum(path.stat().st_size for path in (tmp_path / "in").iterdir()) <= 1 << 18


def test_an_archive_with_too_many_files_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive_module, "MAX_MEMBERS", 3)
    with pytest.raises(UnsafeArchiveError, match="more than 3 files"):
        unpack_data(make_tgz(*(make_file_member(name) for name in "abcd")), tmp_path)


def test_a_header_that_would_fill_the_memory_is_rejected(tmp_path: Path) -> None:
    member = tarfile.TarInfo("a")
    member.pax_headers = {"comment": "x" * (1 << 17)}
    with pytest.raises(UnsafeArchiveError, match="a header of"):
        unpack_data(make_tgz((member, b"")), tmp_path)


def make_header_with_negative_size(kind: bytes) -> bytes:
    """Make a header of this kind with a size of -512 bytes."""
    header = bytearray(tarfile.TarInfo("a").tobuf(tarfile.GNU_FORMAT))
    header[124:136] = b"\xff" * 10 + b"\xfe\x00"
    header[156:157] = kind
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header) + bytes(1024)


@pytest.mark.parametrize("kind", [tarfile.REGTYPE, tarfile.XHDTYPE, tarfile.GNUTYPE_LONGNAME, b"Z"])
def test_a_negative_size_is_rejected_in_any_header(tmp_path: Path, kind: bytes) -> None:
    with pytest.raises(UnsafeArchiveError, match="of -512 bytes"):
        unpack_data(gzip.compress(make_header_with_negative_size(kind)), tmp_path)


@pytest.mark.parametrize("before", [(), (make_file_member("b"),)])
def test_a_negative_size_in_an_extended_header_is_rejected(
    tmp_path: Path, before: tuple[tuple[tarfile.TarInfo, bytes], ...]
) -> None:
    member = tarfile.TarInfo("a")
    member.pax_headers = {"size": "-512"}
    with pytest.raises(UnsafeArchiveError, match="'a', of -512 bytes"):
        unpack_data(make_tgz(*before, (member, b"")), tmp_path)


def test_endless_headers_are_damage(tmp_path: Path) -> None:
    header = tarfile.TarInfo("././@LongLink")
    header.type, header.size = tarfile.GNUTYPE_LONGNAME, 1
    block = header.tobuf(tarfile.GNU_FORMAT) + b"a".ljust(512, b"\0")
    with pytest.raises(DamagedArchiveError):
        unpack_data(gzip.compress(block * 3000), tmp_path)


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    data = make_tgz(make_file_member("a", os.urandom(9000)))
    (tmp_path / "archive").write_bytes(data)
    with limit_file_size(4096), pytest.raises(UserFacingError, match="the disk is full"):
        unpack(tmp_path / "archive", tmp_path / "in", lambda done, total: None)
