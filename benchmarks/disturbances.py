"""What can stand in a pose's way: viewers, subscribers, routers that freeze, go or never come.

And the map: what the service does beside the poses, always and when it is asked to.
"""

import importlib.util
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.pose_arrivals import listening
from tests.belongings import child_running
from tests.ports import free_port
from tests.stand_ins.zenoh_router import running_router
from tests.vo_service.played_service import PlayedService
from vo_service.client import CommandRefused, PoseClient

Act = Callable[[PlayedService], None]


@dataclass(frozen=True)
class Scene:
    """How the service is set up, and what happens: (share of the measured time, what) in order."""

    more_config: str
    acts: tuple[tuple[float, Act], ...] = ()


@dataclass(frozen=True)
class Case:
    """A name, and a context that has everything ready around the service."""

    name: str
    setting: Callable[[Path], AbstractContextManager[Scene]]


@contextmanager
def viewer_recording(folder: Path) -> Iterator[Scene]:
    """Nothing is wrong."""
    yield Scene(_viewers(_recording(folder)))


@contextmanager
def viewer_process_frozen(folder: Path) -> Iterator[Scene]:
    """The process in which the service's own viewer side runs is stopped."""
    yield Scene(_viewers(_recording(folder)), ((0.0, _to_viewer_process(signal.SIGSTOP)),))


@contextmanager
def viewer_process_killed(folder: Path) -> Iterator[Scene]:
    """That process is killed."""
    yield Scene(_viewers(_recording(folder)), ((0.3, _to_viewer_process(signal.SIGKILL)),))


@contextmanager
def viewer_frozen(folder: Path) -> Iterator[Scene]:
    """The Rerun viewer that the service is connected to is stopped."""
    with _rerun_server() as (server, port):
        stop = _signalling(server, signal.SIGSTOP)
        yield Scene(_viewers(_recording(folder), f"connect:127.0.0.1:{port}"), ((0.0, stop),))


@contextmanager
def viewer_killed(folder: Path) -> Iterator[Scene]:
    """The Rerun viewer that the service is connected to is killed."""
    with _rerun_server() as (server, port):
        kill = _signalling(server, signal.SIGKILL)
        yield Scene(_viewers(_recording(folder), f"connect:127.0.0.1:{port}"), ((0.3, kill),))


@contextmanager
def viewer_never_started(folder: Path) -> Iterator[Scene]:
    """Nobody listens where the service sends its pictures."""
    yield Scene(_viewers(_recording(folder), f"connect:127.0.0.1:{free_port()}"))


@contextmanager
def subscriber_frozen(folder: Path) -> Iterator[Scene]:
    """Beside the healthy subscriber there is one that is stopped."""
    frozen: list[int] = []
    contexts = []

    def freeze(service: PlayedService) -> None:
        context = listening(f"tcp/127.0.0.1:{service.port}", folder / "frozen.npz")
        listener = context.__enter__()
        contexts.append(context)
        time.sleep(0.5)
        os.kill(listener.process.pid, signal.SIGSTOP)
        frozen.append(listener.process.pid)

    try:
        yield Scene(_viewers(_recording(folder)), ((0.0, freeze),))
    finally:
        for context in contexts:
            context.__exit__(None, None, None)


@contextmanager
def router_gone_and_back(folder: Path) -> Iterator[Scene]:
    """The service is connected to a router, which is killed and started again."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running_router(endpoint) as router:
        config = f"connect = {json.dumps([endpoint])}\n{_viewers(_recording(folder))}"
        acts: tuple[tuple[float, Act], ...] = (
            (0.3, lambda service: router.kill()),
            (0.6, lambda service: router.start()),
        )
        yield Scene(config, acts)


@contextmanager
def maps_made(folder: Path) -> Iterator[Scene]:
    """A map is asked for four times, fine ones: most of the time one is being made."""
    config = f"{_viewers(_recording(folder))}[map]\nvoxel_m = 0.01\n"
    yield Scene(config, tuple((share, _save_map) for share in (0.0, 0.25, 0.5, 0.75)))


@contextmanager
def no_places_known(folder: Path) -> Iterator[Scene]:
    """Nothing is wrong, and no place is remembered: the others show what that costs."""
    yield Scene(f"{_viewers(_recording(folder))}[map]\nloops = false\n")


CASES = (
    Case("viewer recording", viewer_recording),
    Case("viewer's process frozen", viewer_process_frozen),
    Case("viewer's process killed", viewer_process_killed),
    Case("viewer frozen", viewer_frozen),
    Case("viewer killed", viewer_killed),
    Case("viewer never started", viewer_never_started),
    Case("subscriber frozen", subscriber_frozen),
    Case("router killed and back", router_gone_and_back),
    Case("maps made", maps_made),
    Case("no places known", no_places_known),
)


def _recording(folder: Path) -> str:
    return str(folder / "viewer.rrd")


def _viewers(*targets: str) -> str:
    return f"[rerun]\ntargets = {json.dumps(targets)}\n"


def _to_viewer_process(number: signal.Signals) -> Act:
    def send(service: PlayedService) -> None:
        os.kill(child_running(service.process.pid, "vo_service.viewer.child"), number)

    return send


def _save_map(service: PlayedService) -> None:
    with PoseClient(connect=f"tcp/127.0.0.1:{service.port}") as client:
        client.wait_for_publisher(5.0)
        with suppress(CommandRefused):  # the one before is not finished
            client.save_map(f"map-{time.monotonic_ns()}")


def _signalling(process: "subprocess.Popen[bytes]", number: signal.Signals) -> Act:
    return lambda service: process.send_signal(number)


@contextmanager
def _rerun_server() -> Iterator[tuple["subprocess.Popen[bytes]", int]]:
    """Rerun's own server, which stands for a viewer; killed at the end."""
    package = importlib.util.find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise RuntimeError("Rerun is not installed")
    program, port = Path(package.origin).with_name("rerun"), free_port()
    options = ["--serve-grpc", "--bind", "127.0.0.1", "--port", str(port)]
    command = [str(program), *options, "--server-memory-limit", "100MB"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=quiet, stderr=quiet) as process:
        try:
            time.sleep(1.0)
            yield process, port
        finally:
            process.kill()
