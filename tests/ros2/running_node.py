"""The node in a process with a real rclpy, and ROS programs that use it."""

import json
import signal
import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

from tests.waiting import wait_until

ROOT = Path(__file__).parents[2]
PROGRAM = Path(__file__).with_name("ros_program.py")
TIMEOUT_S = 100.0


@dataclass(frozen=True)
class Ros:
    """ROS programs of one distribution.

    Attributes:
        python: Python that has rclpy.
        environment: Environment variables of the programs.
    """

    python: Path
    environment: Mapping[str, str]

    def run(self, *words: str) -> str:
        """Run a command of ros_program.py and return what it prints."""
        command = [str(self.python), str(PROGRAM), *words]
        return subprocess.check_output(command, env=self.environment, text=True, timeout=TIMEOUT_S)

    @contextmanager
    def reader(self, count: int, *topics: str) -> Iterator["Reader"]:
        """Run a reader of some topics; it is ready at the start of the block."""
        command = [str(self.python), str(PROGRAM), "read", str(count), *topics]
        with subprocess.Popen(
            command, env=self.environment, stdout=subprocess.PIPE, text=True
        ) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == "ready\n"
                reader = Reader(process)
                thread = threading.Thread(target=reader.collect, args=(process.stdout,))
                thread.start()
                yield reader
            finally:
                process.kill()
                thread.join()

    @contextmanager
    def node(self, port: int, *arguments: str, **parameters: object) -> Iterator["NodeProcess"]:
        """Run the node of a kinect-vo at a port; its lines are collected."""
        settings = {"connect": f"tcp/127.0.0.1:{port}", **parameters}
        words = [w for name, value in settings.items() for w in ("-p", f"{name}:={_yaml(value)}")]
        command = [str(self.python), "-m", "kinect_vo_ros2", "--ros-args", *words, *arguments]
        environment = {**self.environment, "PYTHONPATH": str(ROOT / "ros2")}
        with subprocess.Popen(
            command, env=environment, stderr=subprocess.PIPE, text=True
        ) as process:
            node = NodeProcess(process)
            thread = threading.Thread(target=node.collect)
            thread.start()
            try:
                yield node
            finally:
                process.kill()
                thread.join()


@dataclass
class Reader:
    """What a reader has received.

    Attributes:
        process: The process.
        messages: CDR bytes by topic.
    """

    process: subprocess.Popen[str]
    messages: dict[str, list[bytes]] = field(default_factory=dict)

    def collect(self, lines: Iterator[str]) -> None:
        """Collect the messages until the reader ends; one that is killed leaves half a line."""
        for line in takewhile(lambda line: line.endswith("\n"), lines):
            topic, payload = line.split()
            self.messages.setdefault(topic, []).append(bytes.fromhex(payload))

    def first(self, topic: str) -> bytes:
        """Wait for a message and return it."""
        wait_until(lambda: topic in self.messages, f"a message on {topic}")
        return self.messages[topic][0]


@dataclass
class NodeProcess:
    """A running node.

    Attributes:
        process: The process.
        lines: Lines that it has logged.
    """

    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)

    def collect(self) -> None:
        """Collect the lines until the node ends."""
        assert self.process.stderr is not None
        self.lines.extend(iter(self.process.stderr.readline, ""))

    def stop(self, name: str) -> None:
        """Send a signal by its name."""
        self.process.send_signal(signal.Signals[name])

    def wait_for_line(self, text: str) -> None:
        """Wait for a line with this text."""
        wait_until(
            lambda: any(text in line for line in self.lines), lambda: f"{text} in {self.lines}"
        )


def _yaml(value: object) -> str:
    return json.dumps(value)
