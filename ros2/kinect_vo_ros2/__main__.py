"""``kinect-vo-ros2``: run the node until Ctrl-C or SIGTERM."""

import argparse
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.metadata import PackageNotFoundError, version
from typing import NoReturn

from kinect_vo_ros2.middleware import prepare_middleware

EPILOG = """\
examples:
  kinect-vo-ros2
  kinect-vo-ros2 --ros-args -p connect:=tcp/192.168.1.5:7450 -p publish_clock:=true
  kinect-vo-ros2 --ros-args -r __ns:=/robot1 -r odom:=vo/odom -p prefix:=robot1

Parameters, topics and services: docs/guide/ros2.md of kinect-vo. Only nodes on this computer see
this one, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set.
"""


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the node; never returns. Exit codes: 0 stopped; 1 no rclpy; 2 wrong input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog="kinect-vo-ros2",
        description="Publish poses, images and status of a running kinect-vo in ROS 2.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=_own_version())
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, help="ROS's arguments: -p NAME:=VALUE, -r, ..."
    )
    parser.parse_args(arguments)
    profiles = prepare_middleware(os.environ, _rclpy_version())
    with ExitStack() as stack:
        for profile in profiles:
            stack.enter_context(profile)
        _run(arguments, stack.close)
    sys.stderr.flush()
    # All is closed. A thread of Zenoh or rclpy that calls Python while it ends would abort it.
    os._exit(0)


def _own_version() -> str:
    try:
        return version("kinect-vo-ros2")
    except PackageNotFoundError:  # run from a checkout
        return "unknown"


def _rclpy_version() -> str:
    """Return the version of rclpy; end the program if there is none."""
    if importlib.util.find_spec("rclpy") is None:
        _fail(
            "rclpy is missing: source a ROS 2 installation (source /opt/ros/DISTRO/setup.sh)",
            code=1,
        )
    try:
        return version("rclpy")
    except PackageNotFoundError:
        return "0"


def _run(arguments: Sequence[str], on_start: Callable[[], None]) -> None:
    """Run the node; `on_start` is called when the middleware has read its settings."""
    try:
        import rclpy
        from rclpy.exceptions import (
            InvalidParameterTypeException,
            InvalidParameterValueException,
        )
        from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor

        from kinect_vo_ros2.node import KinectVoNode
        from kinect_vo_ros2.zenoh_sessions import SettingsError
    except ImportError as error:
        python = f"{sys.version_info.major}.{sys.version_info.minor}"
        reason = str(error).partition("\n")[0]
        _fail(
            f"ROS 2 cannot be loaded by this Python {python}: {reason}; install kinect-vo-ros2 for "
            "the Python of your ROS",
            code=1,
        )
    try:
        rclpy.init(args=[sys.argv[0], *arguments])
        node = KinectVoNode()
        on_start()
    except (SettingsError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        _fail(str(error), code=2)
    except Exception as error:  # rclpy has no public class for wrong arguments
        if type(error).__module__.startswith("rclpy"):
            _fail(" ".join(str(error).split()), code=2)
        raise
    executor = MultiThreadedExecutor(num_threads=2)
    executor.add_node(node.node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        # A signal that comes just before the executor waits makes the wait fail.
        if rclpy.ok() or not type(error).__module__.startswith("rclpy"):
            raise
    finally:
        node.close()
        rclpy.try_shutdown()


def _fail(message: str, code: int) -> NoReturn:
    print(f"kinect-vo-ros2: error: {message}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
