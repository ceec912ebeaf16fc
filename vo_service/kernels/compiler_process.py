"""A process that compiles kernels, one after the other, into the cache.

Numba compiles in one thread only, so several processors need several processes.
"""

from contextlib import ExitStack
from dataclasses import dataclass

from drivers.core import UserFacingError
from drivers.core.process.service_connection import ServiceConnection
from drivers.core.process.worker_process import WorkerProcess
from drivers.core.process.worker_spec import WorkerSpec
from vo_service.kernels.kernel_list import Signature

COMPILER_WORKER = WorkerSpec("vo_service.kernels.compiler_process:compile_requested", "compiler")


@dataclass(frozen=True)
class CompilerConfig:
    """Nothing: each message tells what to compile."""

    @property
    def fds(self) -> tuple[int, ...]:
        """No file descriptors."""
        return ()


@dataclass(frozen=True)
class KernelCompiled:
    """Message of the process: the kernel is in the cache.

    Attributes:
        error: Why the cache could not be written; None: it is written.
    """

    error: OSError | None = None


class CompilerProcess:
    """The client's side."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        worker = WorkerProcess(COMPILER_WORKER, CompilerConfig())
        self._worker = self._stack.enter_context(worker)

    def fileno(self) -> int:
        """Return what is readable when a kernel is compiled."""
        return self._worker.fileno()

    def start(self, signature: Signature) -> None:
        """Begin to compile a kernel."""
        self._worker.send(signature)

    def is_finished(self) -> bool:
        """Return whether the kernel is compiled.

        Raises:
            OSError: The cache cannot be written.
            UserFacingError: The process has ended.
        """
        try:
            message = self._worker.receive(0.0)
        except EOFError as error:
            self.close()
            raise UserFacingError(
                f"a process that compiles kernels {self._worker.exit_reason}; free some memory and "
                "run kinect-vo warm-up"
            ) from error
        if message is None:  # a line of its log
            return False
        if message.error is not None:
            raise message.error
        return True

    def close(self) -> None:
        """End the process, also in the middle of a kernel."""
        self._worker.kill()
        self._stack.close()


def compile_requested(service: ServiceConnection) -> None:
    """Compile what the messages ask for."""
    for signature in service.messages():
        try:
            signature.compile()
        except OSError as error:
            service.send(KernelCompiled(error))
        else:
            service.send(KernelCompiled())
