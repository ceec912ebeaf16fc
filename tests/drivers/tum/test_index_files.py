import os
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.tum.index_files import ListedImage, read_associations, read_image_list


def write(folder: Path, text: str, name: str = "rgb.txt") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_lines_become_stamps_and_files_beside_the_list(tmp_path: Path) -> None:
    file = write(tmp_path, "# color\n\n1305031102.175304 rgb/a.png\r\n  1305031103,rgb/b.png\n")
    assert read_image_list(file) == [
        ListedImage(Decimal("1305031102.175304"), tmp_path / "rgb/a.png", f"{file}:3"),
        ListedImage(Decimal("1305031103"), tmp_path / "rgb/b.png", f"{file}:4"),
    ]


def test_associations_become_pairs_with_the_exact_skew(tmp_path: Path) -> None:
    line = "1305031102.175304 rgb/a.png 1305031102.160407 depth/a.png\n"
    (pair,) = read_associations(write(tmp_path, line, "associations.txt"))
    assert pair.color.stamp_s == 1305031102.175304
    assert pair.depth.file == tmp_path / "depth/a.png"
    assert pair.skew_s == -0.014897


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", r"rgb\.txt: names no image; expected lines of: stamp file"),
        ("# only\n# comments\n", r"rgb\.txt: names no image"),
        ("1.0 a\n2.0\n", r"rgb\.txt:2: 1 columns where 2 are expected: stamp file"),
        ("1.0 a b\n", r"rgb\.txt:1: 3 columns where 2 are expected"),
        ("1.0 a\n\none b\n", r'rgb\.txt:3: "one" is not a stamp'),
        ("nan a\n", r"rgb\.txt:1: stamp nan is not in seconds"),
        ("inf a\n", r"rgb\.txt:1: stamp inf is not in seconds"),
        ("1305031102175304000 a\n", r"rgb\.txt:1: stamp 1305031102175304000 is not in seconds"),
        ("1e99999 a\n", r"rgb\.txt:1: stamp 1e99999 is not in seconds"),
        ("2.0 a\n1.5 b\n", r"rgb\.txt:2: stamp 1\.5 goes back \(the previous one is 2\.0\)"),
        ("2.0 a\n2.0 b\n", r"rgb\.txt:2: stamp 2\.0 repeats \(the previous one"),
        ("1305031102.0 a\n1305031102.00000001 b\n", r"rgb\.txt:2: stamp .* repeats"),
        ("1 a\n2 ../../etc/passwd\n", r'rgb\.txt:2: "\.\./\.\./etc/passwd" leads out of the'),
        (
            "1 rgb/../a.png\n",
            r'rgb\.txt:1: "rgb/\.\./a\.png" leads out .* give its path relative to it',
        ),
        ("1 /etc/passwd\n", r'rgb\.txt:1: "/etc/passwd" leads out of the recording\'s folder'),
    ],
)
def test_a_wrong_list_is_reported_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        read_image_list(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 a 1\n", r"associations\.txt:1: 3 columns where 4 are expected"),
        ("1 a 1 b\n2 c 1 d\n", r"associations\.txt:2: stamp 1 repeats"),
        ("2 a 1 b\n1 c 2 d\n", r"associations\.txt:2: stamp 1 goes back"),
        ("1 a x b\n", r'associations\.txt:1: "x" is not a stamp'),
        ("1 /a 1 b\n", r'associations\.txt:1: "/a" leads out of the recording'),
        ("1 a 1 ../b\n", r'associations\.txt:1: "\.\./b" leads out of the recording'),
    ],
)
def test_wrong_associations_are_reported_with_their_line(
    tmp_path: Path, text: str, complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint):
        read_associations(write(tmp_path, text, "associations.txt"))


def test_a_list_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_image_list(tmp_path / "rgb.txt")
    (tmp_path / "rgb.txt").write_bytes(b"\x89PNG\xff")
    with pytest.raises(InputError, match=r"rgb.txt:1: is not UTF-8 text"):
        read_image_list(tmp_path / "rgb.txt")


def test_a_folder_of_images_may_be_a_link_to_another_disk(tmp_path: Path) -> None:
    disk, folder = tmp_path / "disk", tmp_path / "recording"
    disk.mkdir()
    folder.mkdir()
    (folder / "rgb").symlink_to(disk)
    (disk / "a.png").write_text("an image")
    (image,) = read_image_list(write(folder, "1 rgb/a.png\n"))
    assert image.file.read_text() == "an image"


@given(parts=st.lists(st.sampled_from(["..", ".", "", "a", "...", "..a", "~"]), min_size=1))
def test_an_accepted_path_stays_below_the_folder(
    tmp_path_factory: pytest.TempPathFactory, parts: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("list")
    file = write(folder, f"1 {'/'.join(parts) or 'a'}\n")
    is_absolute = len(parts) > 1 and parts[0] == ""
    try:
        (image,) = read_image_list(file)
    except InputError:
        assert ".." in parts or is_absolute
    else:
        assert Path(os.path.normpath(image.file)).is_relative_to(folder)


@given(text=st.text(max_size=60) | st.text("0123456789.e-+ \nnaif_#,", max_size=60))
def test_any_text_is_read_or_rejected_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    file = tmp_path_factory.mktemp("list") / "rgb.txt"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    message, stamps = "", list[float]()
    try:
        stamps = [image.stamp_s for image in read_image_list(file)]
    except InputError as error:
        message = str(error)
    assert bool(message) != bool(stamps)
    assert "\n" not in message
    assert stamps == sorted(set(stamps))
