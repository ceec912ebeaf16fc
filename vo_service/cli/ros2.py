"""``kinect-vo ros2``: start the ROS 2 node, which is a distribution of its own."""

import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from drivers.core import UserFacingError
from vo_service.cli.options import DEFAULT_PREFIX, ClientConfigFile, ClientPrefix, Connect
from vo_service.cli.request import CommandRequest, argument
from vo_service.config_tables import DEFAULT_ENDPOINT

PROGRAM = "kinect-vo-ros2"
EPILOG = """\
examples:
  kinect-vo ros2
  kinect-vo ros2 --connect tcp/192.168.1.5:7450 --prefix robot1
  kinect-vo ros2 -- --ros-args -r __ns:=/robot1 -p publish_clock:=true

The node is in the distribution kinect-vo-ros2, for the Python of your ROS 2. docs/guide/ros2.md has
its topics, services and parameters. `kinect-vo-ros2` and `ros2 run kinect_vo node` are the same.
"""


@dataclass(frozen=True, kw_only=True)
class Ros2NodeRequest(CommandRequest):
    """The service that the node connects to, and further arguments of ROS."""

    arguments: tuple[str, ...] = argument("after --: arguments of ROS", "ARGUMENT", default=())
    connect: Connect = DEFAULT_ENDPOINT
    prefix: ClientPrefix = DEFAULT_PREFIX
    config_file: ClientConfigFile = None


def run(request: Ros2NodeRequest) -> int:
    """Replace this process by the node."""
    program = find_program()
    if program is None:
        raise UserFacingError(
            f"{PROGRAM} is not installed: with ROS 2 sourced, run python3 -m pip install {PROGRAM} "
            "(docs/guide/ros2.md)"
        )
    parameters = {
        "connect": request.connect,
        "prefix": request.prefix,
        "config_file": str(request.config_file.absolute()) if request.config_file else "",
    }
    words = [word for item in parameters.items() for word in ("-p", _assignment(*item))]
    os.execv(program, [program, "--ros-args", *words, "--", *request.arguments])


def find_program() -> str | None:
    """Return the node's program: beside this one, or else on PATH; None if it is not installed."""
    folders = (str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath))
    return shutil.which(PROGRAM, path=os.pathsep.join(folders))


def _assignment(name: str, value: str) -> str:
    return f"{name}:={json.dumps(value)}"  # quoted, so that a number stays a text
