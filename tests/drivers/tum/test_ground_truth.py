"""The true poses of folders in TUM format, and what other benchmarks change in it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration import find_calibration
from drivers.core.geometry import is_rigid
from drivers.tum.folder import open_tum_folder
from drivers.tum.ground_truth import T_BONN_MARKERS_CAMERA, read_ground_truth

FolderMaker = Callable[..., Path]


@pytest.mark.parametrize(
    ("name", "fx", "distorted"),
    [
        ("rgbd_bonn_balloon", 542.822841, True),
        ("D1_pre_registereddata", 468.60, False),
        ("corbs_desk", 468.60, False),
    ],
)
def test_bonn_and_corbs_are_known_by_name(
    tmp_path: Path, name: str, fx: float, distorted: bool
) -> None:
    camera = find_calibration(tmp_path / name, None)
    assert (camera.fx, camera.depth_factor, any(camera.distortion)) == (fx, 5000.0, distorted)


def test_bonns_poses_are_converted_from_the_markers_to_the_camera(tmp_path: Path) -> None:
    folder = tmp_path / "rgbd_bonn_balloon"
    folder.mkdir()
    (folder / "groundtruth.txt").write_text("1.0 1 2 3 0 0 0 1\n2.0 1 2 4 0 0 0 1\n")
    truth, note = read_ground_truth(folder, None)
    assert truth is not None
    assert "poses of Bonn's markers, converted to those of the camera" in note
    first, second = truth.T_world_camera
    assert is_rigid(first, 1e-9)
    np.testing.assert_allclose(first[:3, :3], T_BONN_MARKERS_CAMERA[:3, :3], atol=1e-12)
    np.testing.assert_allclose(second[:3, 3] - first[:3, 3], [0, 1, 0], atol=1e-12)


def test_associations_may_have_depth_first(make_folder: FolderMaker) -> None:
    folder = make_folder(count=2)
    lists = [sorted(p.name for p in (folder / kind).iterdir()) for kind in ("rgb", "depth")]
    lines = [f"{n}.5 depth/{d} {n}.4 rgb/{c}" for n, (c, d) in enumerate(zip(*lists, strict=True))]
    (folder / "associations.txt").write_text("\n".join(lines))
    pairs = open_tum_folder(folder, None).frames.pairs
    assert [pair.color.stamp_s for pair in pairs] == [0.4, 1.4]
    assert pairs[0].depth.file.parent.name == "depth"


def test_poses_of_kitti_take_the_stamps_of_the_frames(make_folder: FolderMaker) -> None:
    folder = make_folder(count=3)
    (folder / "groundtruth.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    recording = open_tum_folder(folder, None)
    assert recording.ground_truth is not None
    assert recording.ground_truth.stamps_s.tolist() == recording.frames.stamps_s.tolist()
    assert "KITTI format, one pose for each frame" in recording.summary
