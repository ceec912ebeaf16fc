"""The process that `ForkedProcess` ones are forked from: ``python -m tests.fork_server SOCKET``.

It has loaded what `kinect-vo` needs to follow a camera, and has one thread.
"""

import fcntl
import gc
import json
import os
import signal
import socket
import sys
from pathlib import Path
from typing import Any

from vo_service.cli.dispatch import _set_library_environment

MAX_FDS = 10
MIN_SPARE_FD = 500


def load() -> None:
    """Load libraries and kernels."""
    _set_library_environment()  # before the first of them is imported
    import cv2

    import vo_service.cli.replay
    import vo_service.cli.run  # noqa: F401
    from drivers.core.shared_frames.depth_packing import compile_kernels
    from vo_service.odometry.registry import DEFAULT_METHOD
    from vo_service.odometry.warm_up import warm_up
    from vo_service.reconstruction.warm_up import warm_up_reconstruction
    from vo_service.slam.loop_closure.warm_up import warm_up_loop_closure

    cv2.setNumThreads(1)
    warm_up(DEFAULT_METHOD, _discard_stage)
    warm_up_reconstruction(_discard_stage)
    warm_up_loop_closure(_discard_stage)
    compile_kernels()
    gc.collect()
    gc.freeze()  # else the first collection of each process would copy all of it
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"{threads} threads: a fork would have one of them, and all their locks"


def next_request(connection: socket.socket) -> dict[str, Any] | None:
    """In each new process, what it shall do; None in this one, once nobody can ask any more."""
    while True:
        message, fds, _, _ = socket.recv_fds(connection, 1 << 20, MAX_FDS)
        if not message:
            return None
        forking = os.fork()
        if forking == 0:
            started = os.fork()
            if started == 0:
                connection.close()
                request: dict[str, Any] = json.loads(message)
                _renumber_fds(fds, request["fds"])
                return request
            connection.send(str(started).encode())
            connection.recv(100)
            os._exit(0)
        os.waitpid(forking, 0)
        connection.send(b"let go")
        for fd in fds:
            os.close(fd)


def run_request(request: dict[str, Any]) -> None:
    """Be as a process that was started like this."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if request["is_new_session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = ["-c", *request["arguments"]]
    exec(compile(request["program"], "<string>", "exec"), {"__name__": "__main__"})


def _renumber_fds(fds: list[int], numbers: list[int]) -> None:
    """Open files get other numbers, some of which may be theirs already."""
    out_of_the_way = [fcntl.fcntl(fd, fcntl.F_DUPFD, MIN_SPARE_FD) for fd in fds]
    for fd in fds:
        os.close(fd)
    for fd, number in zip(out_of_the_way, numbers, strict=True):
        os.dup2(fd, number)
        os.close(fd)


def _discard_stage(stage: str) -> None:
    """Nobody waits."""


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for pytest, which ends this one too
    load()
    with socket.socket(fileno=int(sys.argv[1])) as _connection:
        _request = next_request(_connection)
    if _request is not None:
        run_request(_request)
