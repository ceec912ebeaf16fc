"""The distribution of the node: what ROS's tools look for in an environment."""

import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
from kinect_vo_ros2.zenoh_sessions import DEFAULT_ENDPOINT

from tests.ros2.running_node import ROOT, Ros

PROJECT = ROOT / "ros2"
AMENT = PROJECT / "ament"
UV = ROOT / ".tools" / "bin" / "uv"


def project_version(file: Path) -> str:
    return str(tomllib.loads(file.read_text())["project"]["version"])


def test_the_node_has_the_version_of_kinect_vo() -> None:
    package = ElementTree.parse(AMENT / "share" / "kinect_vo" / "package.xml")
    versions = {
        project_version(ROOT / "pyproject.toml"),
        project_version(PROJECT / "pyproject.toml"),
        package.findtext("version"),
    }
    assert len(versions) == 1


def test_the_example_of_parameters_has_the_defaults() -> None:
    text = (AMENT / "share" / "kinect_vo" / "config" / "kinect_vo.yaml").read_text()
    source = (PROJECT / "kinect_vo_ros2" / "settings.py").read_text()
    declared = re.findall(r"^    (\w+): (?:str|bool) = (.+)$", source, re.MULTILINE)
    written = re.findall(r"^    (\w+): (.*?) *#", text, re.MULTILINE)
    assert [name for name, _ in written] == [name for name, _ in declared]
    defaults = {name: value.strip('"').lower() for name, value in declared}
    assert {name: value.strip('"') for name, value in written} == defaults | {
        "connect": DEFAULT_ENDPOINT
    }


def test_the_launch_file_starts_the_node_with_the_parameters_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """ROS's launch is not on PyPI: its classes are replaced by one that keeps what it is given."""
    classes = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros.actions": ["Node"],
    }
    for name in [*classes, "launch_ros"]:
        module = ModuleType(name)
        vars(module).update(dict.fromkeys(classes.get(name, ()), Recorded))
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(AMENT / "share/kinect_vo/launch/kinect_vo.launch.py"))
    ((parameters, _namespace, node),) = description["generate_launch_description"]().values
    assert Path(parameters.options["default_value"]).name == "kinect_vo.yaml"
    assert Path(parameters.options["default_value"]).exists()
    assert (node.options["package"], node.options["executable"]) == ("kinect_vo", "node")


class Recorded:
    """Keeps its arguments."""

    def __init__(self, *values: Any, **options: Any) -> None:
        self.values, self.options = values, options


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    command = f"{UV} build --offline --quiet --wheel --no-create-gitignore --python".split()
    subprocess.run([*command, sys.executable, "--out-dir", folder, PROJECT], check=True)
    (file,) = folder.glob("*.whl")
    return file


@pytest.mark.subprocess
def test_ros_finds_the_installed_node(wheel: Path, ros: Ros, tmp_path: Path) -> None:
    install = f"{UV} pip install --offline --quiet --no-deps --python".split()
    subprocess.run([*install, ros.python, "--prefix", tmp_path, wheel], check=True)
    environment = {**ros.environment, "AMENT_PREFIX_PATH": str(tmp_path)}
    find = "import ament_index_python as a; print(a.get_package_share_directory('kinect_vo'))"
    share = subprocess.check_output([ros.python, "-c", find], env=environment, text=True).strip()
    assert (Path(share) / "launch" / "kinect_vo.launch.py").exists()
    environment["PYTHONPATH"] = str(next(tmp_path.glob("lib/python*/site-packages")))
    node = tmp_path / "lib" / "kinect_vo" / "node"
    usage = subprocess.check_output([node, "--help"], env=environment, text=True)
    assert usage.startswith("usage: kinect-vo-ros2")
    version = subprocess.check_output([node, "--version"], env=environment, text=True)
    assert version.strip() == project_version(PROJECT / "pyproject.toml")
