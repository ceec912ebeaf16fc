"""Settings of the middleware: safe ones, unless the user has made others."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from kinect_vo_ros2.middleware import SEGMENT_BYTES, prepare_middleware

DISTRIBUTIONS = {
    "3.3.11": ("ROS_LOCALHOST_ONLY", "1", "FASTRTPS_DEFAULT_PROFILES_FILE"),  # humble
    "7.1.6": ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "FASTRTPS_DEFAULT_PROFILES_FILE"),
    "9.1.2": ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", "FASTDDS_DEFAULT_PROFILES_FILE"),
}


@pytest.mark.parametrize("rclpy_version", DISTRIBUTIONS)
def test_nothing_leaves_this_computer_by_default(rclpy_version: str) -> None:
    environment: dict[str, str] = {}
    (profile,) = prepare_middleware(environment, rclpy_version)
    discovery, value, variable = DISTRIBUTIONS[rclpy_version]
    assert environment == {discovery: value, variable: profile.name}
    tree = ElementTree.parse(profile.name)
    names = {element.tag.rpartition("}")[2]: element.text for element in tree.iter()}
    assert names["segment_size"] == str(SEGMENT_BYTES)
    assert names["address"] == "127.0.0.1"
    profile.close()
    assert not Path(profile.name).exists()


def test_a_users_network_is_kept() -> None:
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    (profile,) = prepare_middleware(environment, "9.1.2")
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert "127.0.0.1" not in Path(profile.name).read_text()
    profile.close()


@pytest.mark.parametrize("name", ["FASTDDS", "FASTRTPS"])
def test_a_users_profile_is_kept(name: str) -> None:
    environment = {f"{name}_DEFAULT_PROFILES_FILE": "own.xml"}
    assert prepare_middleware(environment, "9.1.2") == []
    assert environment[f"{name}_DEFAULT_PROFILES_FILE"] == "own.xml"


def test_a_profile_of_the_working_folder_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DEFAULT_FASTDDS_PROFILES.xml").touch()
    assert prepare_middleware({}, "9.1.2") == []
