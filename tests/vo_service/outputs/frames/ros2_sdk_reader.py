"""A program with `zenoh-ros2-sdk`, whose code for keys, type hashes and tokens is not ours.

    python -m tests.vo_service.outputs.frames.ros2_sdk_reader PORT FOLDER TOPIC...

It prints the topics and types that it discovers as a JSON object, then "ready" once it subscribes
to the named topics, then the name and the frame of each first message that it receives. FOLDER is
for message definitions, which the library would download otherwise.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

# Its import fails without a git program, which only the download needs.
os.environ["GIT_PYTHON_REFRESH"] = "quiet"

from zenoh_ros2_sdk import ROS2Subscriber, get_topic_names_and_types
from zenoh_ros2_sdk.message_registry import get_registry

PACKAGES = (
    "builtin_interfaces",
    "geometry_msgs",
    "nav_msgs",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
)


def main(port: int, folder: Path, *topics: str) -> None:
    """List, then receive, until standard input is closed."""
    write_definitions(folder)
    get_registry(str(folder))
    found = dict(get_topic_names_and_types(router_port=port, timeout=5.0))
    print(json.dumps(found), flush=True)
    received: set[str] = set()

    def print_first(topic: str, message: Any) -> None:
        if topic not in received:
            received.add(topic)
            # Each topic has its own thread; a single write is not torn.
            os.write(sys.stdout.fileno(), f"{topic} {message.header.frame_id}\n".encode())

    subscribers = [
        ROS2Subscriber(
            topic, found[topic][0], lambda message, topic=topic: print_first(topic, message)
        )
        for topic in topics
    ]
    print("ready", flush=True)
    sys.stdin.read()
    for subscriber in subscribers:
        subscriber.close()


def write_definitions(folder: Path) -> None:
    """Write the definition of each message as FOLDER/PACKAGE/msg/NAME.msg."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in store.types:
        if name.startswith(tuple(f"{package}/" for package in PACKAGES)):
            text, _ = store.generate_msgdef(name, ros_version=2)
            file = folder / f"{name}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text.partition("=" * 80)[0])


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
