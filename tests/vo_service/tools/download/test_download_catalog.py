from pathlib import Path

import pytest

from drivers.calibration import TUM_CALIBRATIONS, find_calibration
from drivers.core import InputError
from vo_service.tools.download.catalog import BENCHMARK_URL, SEQUENCES, find_sequence


@pytest.mark.parametrize(
    "name",
    ["fr1/xyz", "freiburg1/xyz", "fr1_xyz", "FR1/XYZ", "freiburg1_xyz", "fr1/xyz/",
     "rgbd_dataset_freiburg1_xyz", "rgbd_dataset_freiburg1_xyz.tgz"],
)  # fmt: skip
def test_a_name_may_have_any_common_spelling(name: str) -> None:
    assert find_sequence(name).name == "fr1/xyz"


def test_each_name_finds_its_sequence_and_its_folder_the_camera(tmp_path: Path) -> None:
    assert len(SEQUENCES) == len({sequence.name for sequence in SEQUENCES}) == 80
    for sequence in SEQUENCES:
        assert find_sequence(sequence.name) is find_sequence(sequence.folder) is sequence
        known = find_calibration(tmp_path / sequence.folder, None)
        assert known is TUM_CALIBRATIONS[sequence.camera]


def test_addresses_have_the_layout_of_the_benchmarks_host() -> None:
    path = "freiburg2/rgbd_dataset_freiburg2_desk.tgz"
    assert (
        find_sequence("fr2/desk").url(BENCHMARK_URL)
        == f"https://cvg.cit.tum.de/rgbd/dataset/{path}"
    )
    assert find_sequence("fr2/desk").url("http://mirror/tum/") == f"http://mirror/tum/{path}"


def test_only_the_validation_files_have_no_ground_truth() -> None:
    assert sum(sequence.has_ground_truth for sequence in SEQUENCES) == 47
    assert not find_sequence("fr3/walking_xyz_validation").has_ground_truth


@pytest.mark.parametrize(
    ("name", "message"),
    [("fr1/tedy", "did you mean fr1/teddy"), ("teddy", "did you mean fr3/teddy or fr1/teddy"),
     ("fr4/desk", "did you mean fr"), ("??", "no sequence '??'; `kinect-vo")],
)  # fmt: skip
def test_an_unknown_name_gets_similar_names(name: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        find_sequence(name)
    assert message in str(caught.value)
