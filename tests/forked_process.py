"""Processes of kinect-vo forked from a server with loaded libraries and kernels.

A normal start takes a second of processor time, most of it for imports. The processes here are
forked from `tests.fork_server` instead, but they are children of this process. Tests of the start
itself use `subprocess`.
"""

import atexit
import ctypes
import json
import os
import resource
import socket
import subprocess
import sys
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.core.process import worker_process
from tests.simulators.libusb_build import simulated_library_path
from tests.waiting import DEFAULT_TIMEOUT_S
from vo_service.tools.doctor import stream_probe

ROOT = Path(__file__).parents[1]
# The command of the installed script, for a `ForkedProcess`.
KINECT_VO = (sys.executable, "-c", "from vo_service.cli.command_line import main\nmain()\n")
# Worker processes whose start is not what their tests are about.
WORKERS = {
    "drivers.subprocess_camera.worker:run_camera",
    "drivers.synthetic.render_worker:run_renderer",
    "vo_service.mapper_process:run",
    "vo_service.outputs.recorder.worker:run_recorder",
}
# Orphaned descendants become children of the process that sets this, see prctl(2).
_PR_SET_CHILD_SUBREAPER = 36
_LIBRARY_PATH = os.environ.get("LD_LIBRARY_PATH")
_libc = ctypes.CDLL(None)


class ForkedProcess(subprocess.Popen[Any]):
    """Like `subprocess.Popen`, for ``[python, "-c", PROGRAM, ...]``.

    It supports the streams and their encoding, `pass_fds`, `env`, `cwd` and `start_new_session`.
    """

    def _execute_child(
        self, args: Sequence[str], executable: object, preexec_fn: object, close_fds: object,
        pass_fds: Sequence[int], cwd: str | Path | None, env: Mapping[str, str] | None,
        startupinfo: object, creationflags: object, shell: object,
        p2cread: int, p2cwrite: int, c2pread: int, c2pwrite: int, errread: int, errwrite: int,
        restore_signals: object, gid: object, gids: object, uid: object, umask: object,
        start_new_session: bool, process_group: object,
    ) -> None:  # fmt: skip
        """Override the private method of `Popen` that forks and executes."""
        python, option, program, *arguments = args
        assert (python, option) == (sys.executable, "-c")
        request = {
            "program": program,
            "arguments": arguments,
            "folder": str(Path.cwd() if cwd is None else cwd),
            "environment": dict(os.environ if env is None else env),
            "is_new_session": start_new_session,
            "fds": [0, 1, 2, *pass_fds],
        }
        streams = [fd if fd >= 0 else k for k, fd in enumerate((p2cread, c2pwrite, errwrite))]
        self.pid = _get_fork_server().start(request, [*streams, *pass_fds])
        self._child_created = True
        self._close_pipe_fds(p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)  # type: ignore[attr-defined]


def run(
    command: Sequence[str], timeout_s: float = DEFAULT_TIMEOUT_S, **options: Any
) -> "subprocess.CompletedProcess[str]":
    """Run a `ForkedProcess` to its end, and capture its output."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with ForkedProcess(command, **pipes, **options) as process:
        try:
            out, err = process.communicate(timeout=timeout_s)
        finally:
            process.kill()
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def run_module(module: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run a module's program as a `ForkedProcess` to its end, and capture its output."""
    return run([sys.executable, "-c", program_of(module), *arguments])


def start_worker(
    function: str, fds: Sequence[int], stdout: int, stderr: int | None
) -> "subprocess.Popen[bytes]":
    """Replace `worker_process.start_worker` by a `ForkedProcess`."""
    program = "import sys\nfrom drivers.core.process.worker_main import main\n"
    return ForkedProcess(
        [
            *(sys.executable, "-c", f"{program}main(sys.argv[1], int(sys.argv[2]))\n"),
            *(function, str(fds[0])),
        ],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        bufsize=0,
        pass_fds=fds,
        start_new_session=True,
    )


def program_of(module: str) -> str:
    """Text of a program that does what ``python -m MODULE`` does."""
    # The fork server has imported the module, and runpy would warn of it.
    return (
        f"import runpy, sys\nsys.modules.pop({module!r}, None)\n"
        f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)\n"
    )


@contextmanager
def forked_workers(functions: Collection[str]) -> Iterator[None]:
    """Let this process fork the workers that run one of these functions."""
    real, conditions = worker_process.start_worker, _start_conditions()

    def start(function: str, *args: Any, **kwargs: Any) -> "subprocess.Popen[bytes]":
        # A test that changes these needs a new process.
        is_forked = function in functions and _start_conditions() == conditions
        return (start_worker if is_forked else real)(function, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_process, "start_worker", start)
        yield


@contextmanager
def forked_probes() -> Iterator[None]:
    """Let this process fork the processes in which the doctor tries libraries and sensors."""
    real, conditions = subprocess.run, _start_conditions()

    def run_probe(
        command: Sequence[str], timeout: float, **options: Any
    ) -> "subprocess.CompletedProcess[bytes]":
        if _start_conditions() != conditions:
            return real(command, timeout=timeout, **options)
        pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        with ForkedProcess([sys.executable, "-c", program_of(command[-1])], **pipes) as probe:
            try:
                out, err = probe.communicate(options["input"], timeout)
            finally:
                probe.kill()
        return subprocess.CompletedProcess(command, probe.returncode, out, err)

    forking = SimpleNamespace(run=run_probe, TimeoutExpired=subprocess.TimeoutExpired)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream_probe, "subprocess", forking)
        yield


def _start_conditions() -> tuple[object, ...]:
    """Python, where a new process looks for libraries (`cv2` sets this too), and its limits.

    The fork server finds the simulated libusb too, see `tests.fork_server`.
    """
    limits = (resource.RLIMIT_FSIZE, resource.RLIMIT_NOFILE, resource.RLIMIT_AS)
    library_path = os.environ.get("LD_LIBRARY_PATH")
    if library_path == simulated_library_path():
        library_path = _LIBRARY_PATH
    return sys.executable, library_path, *map(resource.getrlimit, limits)


class _ForkServer:
    """The server process; it ends with this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket, server_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with server_socket:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.fork_server", str(server_socket.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                cwd=ROOT,
                pass_fds=[server_socket.fileno()],
            )
        self.pid = self._process.pid
        atexit.register(self._close)

    def start(self, request: Mapping[str, object], fds: Sequence[int]) -> int:
        """Start a child of this process; return its process number."""
        with self._lock:
            socket.send_fds(self._socket, [json.dumps(request).encode()], fds)
            number = self._socket.recv(100)
            with _adopt_orphans():  # only here, so that no other orphans are adopted
                self._socket.send(b"release")
                is_released = self._socket.recv(100)
        assert is_released, "the fork server has ended"
        return int(number)

    def _close(self) -> None:
        self._socket.close()
        self._process.wait()


@contextmanager
def _adopt_orphans() -> Iterator[None]:
    """Let grandchildren whose parent ends become children of this process."""
    _libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        _libc.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


_fork_servers: list[_ForkServer] = []
_fork_servers_lock = threading.Lock()


def fork_server_pids() -> list[int]:
    """Process numbers of the fork server: one, once it was needed."""
    return [server.pid for server in _fork_servers]


def _get_fork_server() -> _ForkServer:
    with _fork_servers_lock:
        if not _fork_servers:
            _fork_servers.append(_ForkServer())
    return _fork_servers[0]
