"""Fixtures of the tests with a real rclpy, in the environments of scripts/setup_ros2.sh."""

import os
import platform
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ports import free_port
from tests.ros2.kinect_vo_service import KinectVo, running_kinect_vo
from tests.ros2.running_node import Ros
from tests.simulators.requirements import skip_or_fail

ROOT = Path(__file__).parents[2]
MACHINE = "x86_64"
# The domains whose ports are below those of the other tests (tests/ports.py).
DOMAINS = range(1, 50)
# What a sourced ROS sets, or a Python with PyPI's rclpy for its children.
ROS_VARIABLES = ("ROS_", "_ROS_", "RMW_", "AMENT_", "FASTDDS_", "FASTRTPS_")
PATH_VARIABLES = ("PYTHONPATH", "LD_LIBRARY_PATH")


def find_python(distribution: str) -> Path:
    """Return the Python that has rclpy of "kilted" or "jazzy"."""
    environment = ROOT / ".ros2" / distribution
    if platform.machine() != MACHINE:
        pytest.skip(f"PyPI has rclpy for {MACHINE} only, and this is {platform.machine()}")
    if not (environment / "contents.txt").exists():  # written when the environment is complete
        skip_or_fail("needs rclpy: run scripts/setup_ros2.sh")
    return environment / "bin" / "python"


@pytest.fixture(scope="session")
def ros2_domain() -> Iterator[int]:
    """A ROS domain that no other pytest process of this computer uses."""
    with socket.socket() as lock:
        yield next(domain for domain in DOMAINS if _bind_port_of(domain, lock))


def _bind_port_of(domain: int, lock: socket.socket) -> bool:
    """Reserve the port by TCP: DDS uses it by UDP."""
    try:
        lock.bind(("127.0.0.1", 7400 + 250 * domain))
    except OSError:
        return False
    return True


@pytest.fixture
def ros2_environment(ros2_domain: int, tmp_path: Path) -> dict[str, str]:
    """Environment variables of a ROS process of this test: on this computer, in its own domain."""
    foreign = (*ROS_VARIABLES, *PATH_VARIABLES)
    own = {name: text for name, text in os.environ.items() if not name.startswith(foreign)}
    return own | {
        "ROS_DOMAIN_ID": str(ros2_domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "HOME": str(tmp_path),  # of ROS's log files
    }


@pytest.fixture
def ros(ros2_environment: dict[str, str]) -> Ros:
    """Programs of kilted."""
    return Ros(find_python("kilted"), ros2_environment)


@pytest.fixture
def port() -> int:
    """A free port of 127.0.0.1."""
    return free_port()


@pytest.fixture
def service(port: int) -> Iterator[KinectVo]:
    """A running kinect-vo at that port."""
    with running_kinect_vo(port) as running:
        yield running
