"""Shared memory: used where there is room, and plain bytes where there is none."""

import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from tests.mount_namespace import AS_MAPPED_ROOT, need_mounts
from tests.ports import free_port
from tests.vo_service.outputs.zenoh.query_helpers import config, connected_session
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until
from vo_service.outputs.frames import MIN_SHARED_BYTES, SharedPayloads
from vo_service.outputs.zenoh import open_session

LOCKABLE_BYTES, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(
        0 <= LOCKABLE_BYTES < 8_000_000,
        reason=f"needs 8 MB of memory that may be locked, here {LOCKABLE_BYTES} bytes: ulimit -l",
    ),
]

IMAGE = bytes(range(256)) * 3600
# This process maps a pool twice, and an ordinary user may lock 8 MB of memory.
POOL_BYTES = 2 * len(IMAGE) + 4096


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def publisher(port: int) -> Iterator[zenoh.Publisher]:
    with open_session(config(port)) as session:
        yield session.declare_publisher("image", priority=zenoh.Priority.BACKGROUND)


def received(publisher: zenoh.Publisher, port: int, payloads: list[zenoh.ZBytes]) -> list[bool]:
    """Publish, and return of each received payload whether it is shared; check its bytes."""
    samples: list[zenoh.Sample] = []
    with connected_session(port) as reader:
        reader.declare_subscriber("image", samples.append)
        wait_until(lambda: bool(publisher.matching_status.matching))  # type: ignore[attr-defined]
        for count, payload in enumerate(payloads, 1):
            publisher.put(payload)
            wait_until(lambda count=count: len(samples) == count)  # type: ignore[misc]
    assert all(IMAGE.startswith(sample.payload.to_bytes()) for sample in samples)
    return [sample.payload.as_shm() is not None for sample in samples]


def test_an_image_is_shared_and_a_small_message_is_not(
    publisher: zenoh.Publisher, port: int
) -> None:
    shared = SharedPayloads(POOL_BYTES)
    payloads = [shared.share(IMAGE), shared.share(IMAGE[: MIN_SHARED_BYTES - 1])]
    assert received(publisher, port, payloads) == [True, False]


def test_a_reader_that_keeps_all_buffers_gets_plain_bytes(
    publisher: zenoh.Publisher, port: int
) -> None:
    shared = SharedPayloads(POOL_BYTES)
    kept = [shared.share(IMAGE) for _ in range(4)]
    assert received(publisher, port, kept) == [True, True, False, False]


def test_a_pool_that_is_larger_than_the_memory_gives_plain_bytes() -> None:
    shared = SharedPayloads(pool_bytes=1 << 50)
    assert shared.share(IMAGE).to_bytes() == IMAGE
    assert shared.share(IMAGE).as_shm() is None


# In a mount namespace of its own, /dev/shm may be small, full or read-only.
PROGRAM = Path(__file__).with_name("limited_shared_memory.py")


@pytest.mark.subprocess
@pytest.mark.parametrize(
    ("options", "arguments", "is_shared"),
    [
        ("size=100M", "", True),
        ("size=100M", "fill", True),
        ("size=1M", "", False),
        ("size=100M,ro", "", False),
    ],
    ids=["large", "full after the first image", "small", "read-only"],
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
