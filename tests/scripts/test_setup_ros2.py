"""The set-up of ROS 2 for the tests: where it has no packages, and what it pins."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "scripts"


@pytest.mark.subprocess
def test_another_processor_is_told_why_the_tests_do_not_run(tmp_path: Path) -> None:
    (tmp_path / "uname").write_text("#!/bin/sh\necho Linux aarch64\n")
    (tmp_path / "uname").chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    printed = subprocess.check_output(
        [SCRIPTS / "setup_ros2.sh"], env=os.environ | {"PATH": path}, text=True
    )
    (line,) = printed.split("\n")[1:-1]
    assert "do not run here: PyPI has rclpy for Linux x86_64, and this is Linux aarch64" in line


@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
def test_nodes_are_tested_with_the_locked_version_of_zenoh(distribution: str) -> None:
    lock = tomllib.loads((ROOT / "uv.lock").read_text())
    locked = [each["version"] for each in lock["package"] if each["name"] == "eclipse-zenoh"]
    pinned = (SCRIPTS / "ros2" / f"{distribution}.txt").read_text()
    assert re.findall(r"^eclipse-zenoh==(\S+)", pinned, re.MULTILINE) == locked
