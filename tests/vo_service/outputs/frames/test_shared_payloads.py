"""Shared memory: used where there is room, and plain bytes where there is none."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.forked_process import run_module
from tests.mount_namespace import AS_MAPPED_ROOT, need_mounts
from tests.waiting import DEFAULT_TIMEOUT_S
from vo_service.outputs.frames.shared_payloads import MIN_SHARED_BYTES, SharedPayloads

LOCKABLE_BYTES, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(
        0 <= LOCKABLE_BYTES < 8_000_000,
        reason=f"needs 8 MB of memory that may be locked, here {LOCKABLE_BYTES} bytes: ulimit -l",
    ),
]

# A process of its own may lock memory, whatever the pools of other tests have locked.
PROGRAM = Path(__file__).with_name("limited_shared_memory.py")
MODULE = "tests.vo_service.outputs.frames.limited_shared_memory"


@pytest.mark.subprocess
@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        ([], ["True 921600"] * 3),
        (["small"], ["False 16383"] * 3),
        (["keep"], ["True 921600", "True 921600", "False 921600"]),
    ],
    ids=["image", "small message", "more than the pool has room for"],
)
def test_payloads_are_shared_if_they_are_large_and_have_room(
    arguments: list[str], printed: list[str]
) -> None:
    done = run_module(MODULE, *arguments)
    assert (done.returncode, done.stdout.splitlines()) == (0, printed), done.stderr


def test_a_pool_that_is_larger_than_the_memory_gives_plain_bytes() -> None:
    shared = SharedPayloads(pool_bytes=1 << 50)
    image = bytes(MIN_SHARED_BYTES)
    assert shared.share(image).to_bytes() == image
    assert shared.share(image).as_shm() is None


# In a mount namespace of its own, /dev/shm may be small, full or read-only.
@pytest.mark.subprocess
@pytest.mark.parametrize(
    ("options", "arguments", "is_shared"),
    [
        ("size=100M", "fill", True),
        ("size=1M", "", False),
        ("size=100M,ro", "", False),
    ],
    ids=["full after the first image", "small", "read-only"],
)
def test_frames_arrive_whatever_dev_shm_is(options: str, arguments: str, is_shared: bool) -> None:
    done = run_with_dev_shm(options, f"{sys.executable} {PROGRAM} {arguments}")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(is_shared), "921600"] * 3


@pytest.mark.subprocess
def test_what_a_killed_process_leaves_is_removed_by_the_next() -> None:
    program, names = f"{sys.executable} {PROGRAM}", "echo $(ls /dev/shm)"
    done = run_with_dev_shm("size=100M", f"{program} kill; {names}; {program}; {names}")
    _, left, *images, left_then = done.stdout.splitlines()
    assert images == ["True 921600"] * 3
    assert left
    assert set(left.split()).isdisjoint(left_then.split())


def run_with_dev_shm(options: str, command: str) -> "subprocess.CompletedProcess[str]":
    """Run a shell command with a /dev/shm of its own."""
    need_mounts(AS_MAPPED_ROOT)
    script = f"mount -t tmpfs -o {options} tmpfs /dev/shm && {{ {command}; }}"
    return subprocess.run(
        [*AS_MAPPED_ROOT, "sh", "-c", script],
        capture_output=True,
        text=True,
        timeout=DEFAULT_TIMEOUT_S,
        check=False,
    )
