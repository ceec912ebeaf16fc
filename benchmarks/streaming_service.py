"""The service on the virtual Kinect, whose room is rendered before."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from subprocess import Popen

from drivers.core.folders import cache_folder
from drivers.synthetic.frame_provider import render_all
from tests.forked_process import ForkedProcess
from tests.vo_service.service_process import START_TIMEOUT_S, ServiceProcess, running_service
from vo_service.config import read_config
from vo_service.terminal import Terminal


@contextmanager
def streaming_service(
    more_config: str, *options: str, popen: Callable[..., Popen[bytes]] = ForkedProcess
) -> Iterator[ServiceProcess]:
    """Run the service in a temporary folder; it publishes poses.

    Args:
        more_config: As of `running_service`; FOLDER in it is the folder.
        options: Of `kinect-vo run`.
        popen: Starts it.
    """
    # The recorder of a killed service may still write.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        config, file = more_config.replace("FOLDER", folder), Path(folder, "room.toml")
        file.write_text(f"schema = 1\n[zenoh]\n{config}")
        progress = partial(Terminal().progress, "rendering the room: frame")
        render_all(read_config(file).synthetic, cache_folder() / "sequences", progress).close()
        with running_service(
            Path(folder) / "service",
            {},
            *options,
            source="synthetic",
            more_config=config,
            popen=popen,
        ) as service:
            service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
            yield service
