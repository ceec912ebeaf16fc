"""Possible disturbances of the poses: viewers, subscribers and routers that freeze, end or miss.

Map saving and loop closure are cases too.
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

from benchmarks.service_load import running_recorder
from tests.ports import free_port
from tests.resource_leaks import find_child_running
from tests.simulators.zenoh_router import running_router
from tests.vo_service.service_process import ServiceProcess
from vo_service import CommandRefused, PoseClient
from vo_service.types.commands import SaveMapCommand

Action = Callable[[ServiceProcess], None]


@dataclass(frozen=True)
class InterferenceSetup:
    """Configuration of the service, and actions at fractions of the measured time, in order."""

    more_config: str
    actions: tuple[tuple[float, Action], ...] = ()


@dataclass(frozen=True)
class InterferenceCase:
    """A name, and a context manager that prepares the environment of the service."""

    name: str
    setup: Callable[[Path], AbstractContextManager[InterferenceSetup]]


@contextmanager
def record_to_viewer_file(folder: Path) -> Iterator[InterferenceSetup]:
    """No disturbance; the viewer records into a file."""
    yield InterferenceSetup(_viewers(_recording(folder)))


@contextmanager
def freeze_viewer_process(folder: Path) -> Iterator[InterferenceSetup]:
    """Stop the service's viewer process by SIGSTOP."""
    yield InterferenceSetup(
        _viewers(_recording(folder)), ((0.0, _make_viewer_signal_action(signal.SIGSTOP)),)
    )


@contextmanager
def kill_viewer_process(folder: Path) -> Iterator[InterferenceSetup]:
    """Kill the service's viewer process."""
    yield InterferenceSetup(
        _viewers(_recording(folder)), ((0.3, _make_viewer_signal_action(signal.SIGKILL)),)
    )


@contextmanager
def freeze_viewer(folder: Path) -> Iterator[InterferenceSetup]:
    """Stop the Rerun viewer to which the service is connected."""
    with _rerun_server() as (server, port):
        stop = _make_signal_action(server, signal.SIGSTOP)
        yield InterferenceSetup(
            _viewers(_recording(folder), f"connect:127.0.0.1:{port}"), ((0.0, stop),)
        )


@contextmanager
def kill_viewer(folder: Path) -> Iterator[InterferenceSetup]:
    """Kill the Rerun viewer to which the service is connected."""
    with _rerun_server() as (server, port):
        kill = _make_signal_action(server, signal.SIGKILL)
        yield InterferenceSetup(
            _viewers(_recording(folder), f"connect:127.0.0.1:{port}"), ((0.3, kill),)
        )


@contextmanager
def missing_viewer(folder: Path) -> Iterator[InterferenceSetup]:
    """There is no viewer at the service's target."""
    yield InterferenceSetup(_viewers(_recording(folder), f"connect:127.0.0.1:{free_port()}"))


@contextmanager
def freeze_subscriber(folder: Path) -> Iterator[InterferenceSetup]:
    """Stop a second subscriber beside the measuring one."""
    frozen: list[int] = []
    contexts = []

    def freeze(service: ServiceProcess) -> None:
        context = running_recorder(f"tcp/127.0.0.1:{service.port}", folder / "frozen.npz")
        listener = context.__enter__()
        contexts.append(context)
        time.sleep(0.5)
        os.kill(listener.process.pid, signal.SIGSTOP)
        frozen.append(listener.process.pid)

    try:
        yield InterferenceSetup(_viewers(_recording(folder)), ((0.0, freeze),))
    finally:
        for context in contexts:
            context.__exit__(None, None, None)


@contextmanager
def restart_router(folder: Path) -> Iterator[InterferenceSetup]:
    """Kill and restart a router to which the service is connected."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running_router(endpoint) as router:
        config = f"connect = {json.dumps([endpoint])}\n{_viewers(_recording(folder))}"
        acts: tuple[tuple[float, Action], ...] = (
            (0.3, lambda service: router.kill()),
            (0.6, lambda service: router.start()),
        )
        yield InterferenceSetup(config, acts)


@contextmanager
def save_maps(folder: Path) -> Iterator[InterferenceSetup]:
    """Save a fine map four times: the mapper is busy most of the time."""
    config = f"{_viewers(_recording(folder))}[map]\nvoxel_m = 0.01\n"
    yield InterferenceSetup(config, tuple((share, _save_map) for share in (0.0, 0.25, 0.5, 0.75)))


@contextmanager
def disable_loop_closure(folder: Path) -> Iterator[InterferenceSetup]:
    """No disturbance and no loop closure: the other cases show its cost."""
    yield InterferenceSetup(f"{_viewers(_recording(folder))}[map]\nloop_closure = false\n")


CASES = (
    InterferenceCase("viewer recording", record_to_viewer_file),
    InterferenceCase("viewer's process frozen", freeze_viewer_process),
    InterferenceCase("viewer's process killed", kill_viewer_process),
    InterferenceCase("viewer frozen", freeze_viewer),
    InterferenceCase("viewer killed", kill_viewer),
    InterferenceCase("viewer never started", missing_viewer),
    InterferenceCase("subscriber frozen", freeze_subscriber),
    InterferenceCase("router killed and back", restart_router),
    InterferenceCase("maps saved", save_maps),
    InterferenceCase("no loop closure", disable_loop_closure),
)


def _recording(folder: Path) -> str:
    return str(folder / "viewer.rrd")


def _viewers(*targets: str) -> str:
    return f"[rerun]\ntargets = {json.dumps(targets)}\n"


def _make_viewer_signal_action(number: signal.Signals) -> Action:
    def send(service: ServiceProcess) -> None:
        os.kill(
            find_child_running(service.process.pid, "vo_service.outputs.rerun.worker:run_viewer"),
            number,
        )

    return send


def _save_map(service: ServiceProcess) -> None:
    with PoseClient(connect=f"tcp/127.0.0.1:{service.port}") as client:
        client.wait_for_publisher(5.0)
        with suppress(CommandRefused):  # the previous save is not finished
            client.send(SaveMapCommand(f"map-{time.monotonic_ns()}"))


def _make_signal_action(process: "subprocess.Popen[bytes]", number: signal.Signals) -> Action:
    return lambda service: process.send_signal(number)


@contextmanager
def _rerun_server() -> Iterator[tuple["subprocess.Popen[bytes]", int]]:
    """Run Rerun's server in place of a viewer; kill it at the end."""
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
