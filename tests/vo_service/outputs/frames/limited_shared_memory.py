"""Publishes three images to a subscriber in this process's second session; prints how they came.

With the argument "fill", /dev/shm becomes full after the first image; with "kill", the process is
killed then; with "keep", all three exist before the first is published; with "small", they are
smaller than what is shared.
"""

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[4]))

import zenoh

from tests.ports import free_port
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.frames.shared_payloads import MIN_SHARED_BYTES, SharedPayloads
from vo_service.outputs.zenoh.session import open_session


def fill(file: Path) -> None:
    """Write until the file system is full."""
    with file.open("wb", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(bytes(4096))


endpoint = f"tcp/127.0.0.1:{free_port()}"
arguments = sys.argv[1:]
image = bytes(range(256)) * 3600
if arguments == ["small"]:
    image = image[: MIN_SHARED_BYTES - 1]
# One process maps the pool twice here: both have to fit into what it may lock.
shared = SharedPayloads(pool_bytes=2 << 20)
with (
    open_session(ZenohConfig(listen=(endpoint,))) as session,
    open_session(ZenohConfig(listen=(), connect=(endpoint,))) as reader,
):
    samples = reader.declare_subscriber("image")
    # No image is dropped if this computer is busy.
    publisher = session.declare_publisher("image", congestion_control=zenoh.CongestionControl.BLOCK)
    wait_until(lambda: publisher.matching_status.matching)  # type: ignore[attr-defined]
    kept = [shared.share(image) for _ in range(3)] if arguments == ["keep"] else []
    for _ in range(3):
        publisher.put(kept.pop(0) if kept else shared.share(image))
        payload = samples.recv().payload
        assert payload.to_bytes() == image
        print(payload.as_shm() is not None, len(payload), flush=True)
        if arguments == ["fill"]:
            fill(Path("/dev/shm/other"))
        elif arguments == ["kill"]:
            os.kill(os.getpid(), signal.SIGKILL)
