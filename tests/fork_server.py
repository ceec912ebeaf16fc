"""The fork server of `ForkedProcess`: ``python -m tests.fork_server SOCKET``.

It has loaded the libraries and kernels of `kinect-vo run` and `replay`, and has one thread.
"""

import atexit
import ctypes
import fcntl
import gc
import json
import os
import signal
import socket
import sys
import threading
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.simulators.libusb_build import SONAME
from vo_service.cli.command_line import set_library_environment

MAX_FDS = 10
MIN_SPARE_FD = 500


def load() -> None:
    """Load libraries and kernels."""
    set_library_environment()  # before the libraries are imported
    import cv2
    import pytest

    import vo_service.cli.replay
    import vo_service.cli.run  # noqa: F401
    from tests.forked_process import WORKERS
    from tests.warm_ups import skip_repeated_warm_ups
    from vo_service.cli.kernels import prepare_kernels
    from vo_service.config import Config
    from vo_service.frame_packing import compile_kernels
    from vo_service.reconstruction.warm_up import warm_up_reconstruction
    from vo_service.signals import StopSignal
    from vo_service.slam import synchronous_loop_closure
    from vo_service.terminal import Terminal

    cv2.setNumThreads(1)
    for function in WORKERS:
        import_module(function.partition(":")[0])
    skip_repeated_warm_ups(pytest.MonkeyPatch())
    prepare_kernels(Config(), Terminal(), StopSignal())
    warm_up_reconstruction(_discard_stage)
    synchronous_loop_closure.warm_up_loop_closure(_discard_stage)
    compile_kernels()
    gc.collect()
    gc.freeze()  # otherwise the first collection of each child would copy all pages
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"{threads} threads: a fork would have one of them and all locks"


def next_request(connection: socket.socket) -> dict[str, Any] | None:
    """Fork a process for each request.

    Returns:
        The request, in each new process; None in this process, when the connection is closed.
    """
    while True:
        message, fds, _, _ = socket.recv_fds(connection, 1 << 20, MAX_FDS)
        if not message:
            return None
        intermediate = os.fork()
        if intermediate == 0:
            child = os.fork()
            if child == 0:
                connection.close()
                request: dict[str, Any] = json.loads(message)
                _renumber_fds(fds, request["fds"])
                return request
            connection.send(str(child).encode())
            connection.recv(100)
            os._exit(0)
        os.waitpid(intermediate, 0)
        connection.send(b"released")
        for fd in fds:
            os.close(fd)


def run_request(request: dict[str, Any]) -> None:
    """Run the request's program, as in a newly started process."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if request["is_new_session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    _load_simulated_libusb()
    sys.argv = ["-c", *request["arguments"]]
    code: object = None
    try:
        exec(compile(request["program"], "<string>", "exec"), {"__name__": "__main__"})
    except SystemExit as end:
        code = end.code
    _exit_without_cleanup(code)
    sys.exit(code)  # type: ignore[arg-type]


def _load_simulated_libusb() -> None:
    """Load the simulated libusb: only a new process finds libraries by LD_LIBRARY_PATH."""
    for folder in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep):
        if folder and (library := Path(folder) / SONAME).exists():
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def _exit_without_cleanup(code: object) -> None:
    """End as Python does, but free no objects: that would copy all pages of the fork server.

    It returns if Python has an error to report.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    if code is None or isinstance(code, int):
        with suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit((code or 0) & 0xFF)


def _renumber_fds(fds: list[int], numbers: list[int]) -> None:
    """Give open files the numbers of the request; the two sets of numbers may overlap."""
    spare_fds = [fcntl.fcntl(fd, fcntl.F_DUPFD, MIN_SPARE_FD) for fd in fds]
    for fd in fds:
        os.close(fd)
    for fd, number in zip(spare_fds, numbers, strict=True):
        os.dup2(fd, number)
        os.close(fd)


def _discard_stage(stage: str) -> None:
    """Ignore progress."""


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # pytest handles Ctrl-C and ends this process
    load()
    with socket.socket(fileno=int(sys.argv[1])) as _connection:
        _request = next_request(_connection)
    if _request is not None:
        run_request(_request)
