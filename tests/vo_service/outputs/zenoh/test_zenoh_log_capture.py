"""Zenoh's log is captured from standard output; all other output stays."""

import subprocess
import sys

import pytest

from tests.waiting import DEFAULT_TIMEOUT_S

pytestmark = pytest.mark.subprocess

BEGIN = (
    "import os, subprocess, sys\n"
    "from vo_service.outputs.zenoh.access_denied_log import capture_zenoh_log\n"
)


def run(script: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", BEGIN + script]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=DEFAULT_TIMEOUT_S, check=False
    )


def test_the_output_of_the_program_and_its_children_is_forwarded() -> None:
    done = run(
        "print('before')\n"
        "with capture_zenoh_log():\n"
        "    print('within')\n"
        "    subprocess.run(['echo', 'a child'])\n"
        "print('after')\n"
    )
    assert sorted(done.stdout.split("\n")) == ["", "a child", "after", "before", "within"]
    assert (done.stderr, done.returncode) == ("", 0)


def test_standard_output_is_restored() -> None:
    done = run(
        "files = len(os.listdir('/proc/self/fd'))\n"
        "for _ in range(3):\n"
        "    with capture_zenoh_log(): pass\n"
        "os.write(1, b'direct\\n')\n"
        "print(len(os.listdir('/proc/self/fd')) - files)\n"
    )
    assert done.stdout == "direct\n0\n"


def test_a_surviving_child_does_not_block_it() -> None:
    done = run(
        "with capture_zenoh_log():\n"
        "    child = subprocess.Popen(['sleep', '60'])\n"
        "child.kill()\n"
        "print('over')\n"
    )
    assert (done.stdout, done.returncode) == ("over\n", 0)


def test_a_closed_standard_output_is_no_error() -> None:
    script = (
        "with capture_zenoh_log():\n"
        "    subprocess.run(['echo', 'to nobody'])\n"
        "sys.stderr.write('still here')\n"
    )
    command = [sys.executable, "-c", BEGIN + script]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == "still here"
