"""ROS 1's own tools, Debian's python3-rosbag, read our bags, and we read theirs."""

import json
import re
import subprocess
from pathlib import Path

import pytest

from drivers.playback.recording_formats import open_recording
from tests.drivers.bag.test_bag import make_bag
from tests.drivers.tum.read_recording import assert_same, read_recording
from tests.simulators.requirements import require_program
from tests.vo_service.tools.test_convert import convert_path

pytestmark = pytest.mark.subprocess

# Run by the system's Python: rosbag is no package of the environment.
LIST_MESSAGES = """
import json, sys, rosbag
for topic, message, t in rosbag.Bag(sys.argv[1]):
    header = getattr(message, "header", None)
    fields = [header.seq, header.stamp.to_nsec()] if header else [None, None]
    print(json.dumps([topic, t.to_nsec(), *fields]))
"""
COPY = """
import sys, rosbag
source, copy, compression = sys.argv[1:]
with rosbag.Bag(copy, "w", compression=compression) as out:
    for topic, message, t in rosbag.Bag(source):
        out.write(topic, message, t)
"""


def run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr, done.stderr
    return done.stdout


@pytest.fixture
def rosbag() -> str:
    return require_program("rosbag", "python3-rosbag")


@pytest.fixture
def our_bag(rosbag: str, tmp_path: Path) -> Path:
    make_bag(tmp_path / "original")
    convert_path(tmp_path / "original", tmp_path / "ours.bag")
    return tmp_path / "ours.bag"


@pytest.mark.parametrize("command", ["check", "decompress", "info", "compress"])
def test_the_commands_of_rosbag_read_our_bag(rosbag: str, our_bag: Path, command: str) -> None:
    run(rosbag, command, our_bag)
    assert len(open_recording(our_bag).frames.pairs) == 4


def test_every_message_of_our_bag_is_read_with_its_stamp(our_bag: Path) -> None:
    lines = run("/usr/bin/python3", "-c", LIST_MESSAGES, our_bag).splitlines()
    messages = [json.loads(line) for line in lines]
    stamped = [each for each in messages if each[3] is not None]
    topics = {topic for topic, *_ in stamped}
    assert "/camera/rgb/image_raw" in topics
    for topic in topics:
        sequence = [seq for each, _, seq, _ in stamped if each == topic]
        assert sequence == list(range(len(sequence)))
    assert all(log_ns == stamp_ns for _, log_ns, _, stamp_ns in stamped)


@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
def test_we_read_a_bag_that_rosbag_wrote(our_bag: Path, compression: str) -> None:
    copy = our_bag.with_name("theirs.bag")
    run("/usr/bin/python3", "-c", COPY, our_bag, copy, compression)
    assert re.search(f"compression: +{compression} ", run("rosbag", "info", copy))
    assert_same(read_recording(copy), read_recording(our_bag))
