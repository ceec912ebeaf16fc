import errno
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.core import InputError
from drivers.tum.folder import open_tum_folder

FolderMaker = Callable[..., Path]


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_tum_folder(folder, None)
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(str(folder), "DIR")


def first_image(folder: Path, kind: str) -> Path:
    return min((folder / kind).iterdir())


def test_frames_are_paired_by_stamp(make_folder: FolderMaker) -> None:
    frames = open_tum_folder(make_folder(count=3), None).frames
    assert [round(pair.skew_s, 6) for pair in frames.pairs] == [0.005] * 3
    assert frames.unpaired == 0


def test_images_without_a_partner_are_counted(make_folder: FolderMaker) -> None:
    folder = make_folder(count=4, skew_s=0.005)
    assert open_tum_folder(folder, None).summary == ""
    depth = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join([*depth[:2], *depth[3:]]))
    recording = open_tum_folder(folder, None)
    assert (len(recording.frames.pairs), recording.frames.unpaired) == (3, 1)
    assert recording.summary == f"{folder}: images without a partner: 1"


def test_associations_override_the_lists(make_folder: FolderMaker) -> None:
    folder = make_folder(count=3)
    color, depth = first_image(folder, "rgb").name, first_image(folder, "depth").name
    (folder / "associations.txt").write_text(f"1.0 rgb/{color} 1.1 depth/{depth}\n")
    (pair,) = open_tum_folder(folder, None).frames.pairs
    assert (pair.color.stamp_s, pair.skew_s) == (1.0, 0.1)


def test_ground_truth_is_read_where_it_is(make_folder: FolderMaker) -> None:
    folder = make_folder()
    assert open_tum_folder(folder, None).ground_truth is None
    (folder / "groundtruth.txt").write_text("1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n")
    truth = open_tum_folder(folder, None).ground_truth
    assert truth is not None
    assert len(truth) == 2


@pytest.mark.parametrize("text", ["1 0 0 0 0 0 0 nan\n", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"])
def test_bad_ground_truth_is_refused(make_folder: FolderMaker, text: str) -> None:
    folder = make_folder()
    (folder / "groundtruth.txt").write_text(text)
    assert re.match(r"DIR/groundtruth\.txt:\d: ", complaint(folder))


def test_an_invalid_folder_is_rejected(tmp_path: Path) -> None:
    assert complaint(tmp_path / "gone") == "DIR: no such folder; check the path"
    assert complaint(tmp_path) == ("DIR: the folder is empty; name one with rgb.txt and depth.txt")
    (tmp_path / "archive.tgz").write_bytes(b"")
    assert "unpack an archive and name its folder" in complaint(tmp_path / "archive.tgz")


def test_a_folder_without_permission_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)  # root may read every folder
    assert complaint(tmp_path) == "DIR: cannot be read: Permission denied"


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_a_list_that_is_missing_or_empty_is_refused(make_folder: FolderMaker, name: str) -> None:
    folder = make_folder()
    (folder / name).write_text("# nothing\n")
    assert complaint(folder) == f"DIR/{name}: names no image; expected lines of: stamp file"
    (folder / name).unlink()
    assert complaint(folder).startswith(f"DIR/{name}: no such file; a TUM folder holds")


def test_lists_of_different_times_are_refused(make_folder: FolderMaker) -> None:
    folder = make_folder(count=2, period_s=1.0, skew_s=0.3)
    assert "no color and depth images within 20 ms of each other" in complaint(folder)


def test_a_folder_without_a_camera_is_refused(make_folder: FolderMaker) -> None:
    folder = make_folder()
    (folder / "camera.toml").unlink()
    assert "DIR: no camera file" in complaint(folder)


@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_a_missing_first_frame_is_reported_with_its_line(
    make_folder: FolderMaker, kind: str
) -> None:
    folder = make_folder()
    gone = first_image(folder, kind)
    gone.unlink()
    assert complaint(folder) == (
        f"DIR/{kind}.txt:2: names DIR/{kind}/{gone.name}, which is missing "
        "(1 of 5 frames lack a file); restore it or remove the line"
    )


def test_a_folder_without_most_of_its_files_is_rejected(make_folder: FolderMaker) -> None:
    folder = make_folder()
    for file in sorted((folder / "rgb").iterdir())[2:]:
        file.unlink()
    assert complaint(folder).startswith("DIR/rgb.txt:4: names DIR/rgb/")


def test_a_single_missing_file_in_the_middle_is_accepted(make_folder: FolderMaker) -> None:
    folder = make_folder()
    sorted((folder / "depth").iterdir())[2].unlink()
    assert len(open_tum_folder(folder, None).frames.pairs) == 5


def test_a_first_frame_of_a_wrong_type_is_rejected_with_its_line(make_folder: FolderMaker) -> None:
    folder = make_folder()
    depth = first_image(folder, "depth")
    cv2.imwrite(str(depth), np.zeros((48, 64), np.uint8))
    message = complaint(folder)
    assert message.startswith(f"DIR/depth/{depth.name}: depth has 8 bits and 1 channel(s)")
    assert message.endswith("(the first frame, DIR/rgb.txt:2)")


def test_images_unlike_the_camera_file_are_refused(make_folder: FolderMaker) -> None:
    folder = make_folder()
    text = (folder / "camera.toml").read_text()
    (folder / "camera.toml").write_text(text.replace("width = 64", "width = 80"))
    assert "the image is 64x48 but the camera is 80x48" in complaint(folder)
