"""Compilation of the kernels of parts, in as many processes as there are processors."""

import heapq
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from graphlib import TopologicalSorter
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, cast

from drivers.core.folders import kernel_folder
from drivers.core.memory import available_memory_bytes
from vo_service.kernels.compiler_process import CompilerProcess
from vo_service.kernels.kernel_list import Signature, read_kernel_list

# The largest resident set of a process that compiles `direct`.
PROCESS_BYTES = 350e6
# How often the progress is reported, and a stop request seen.
POLL_S = 0.1


def ensure_compiled(parts: Sequence[str], report: Callable[[str], None]) -> None:
    """Compile the kernels of parts unless that was done before, with this source.

    Args:
        parts: Names in the list; others have no kernels.
        report: Called with the progress, several times a second; its exception ends the
            compilation.

    Raises:
        OSError: The cache cannot be written.
        UserFacingError: A process was killed.
    """
    missing = [part for part in parts if not _mark(part).exists()]
    signatures = {
        each.signature.text: each.signature for each in read_kernel_list() if each.part in missing
    }
    if signatures:
        _compile(list(signatures.values()), report)
        os.sync()  # before the marks: a power cut must not leave marks of empty files
    for part in missing:
        with suppress(OSError):  # without the mark, it is looked after again next time
            _mark(part).touch()


def _mark(part: str) -> Path:
    """Return a file that exists if the part is compiled; its name has the state of the source."""
    own_folder = kernel_folder()
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or own_folder)
    return folder / f"{own_folder.name}-{part.replace(' ', '-')}-is-compiled"


def _compile(signatures: Sequence[Signature], report: Callable[[str], None]) -> None:
    callees = find_callees(signatures)
    order = TopologicalSorter(callees)
    order.prepare()
    depths = _call_depths(callees)
    waiting: list[tuple[int, int]] = []  # the deepest first: most others wait for it
    done = 0
    with ExitStack() as stack:
        idle = [stack.enter_context(closing(CompilerProcess())) for _ in range(process_count())]
        running: dict[int, tuple[CompilerProcess, int]] = {}  # by the file descriptor
        while order.is_active():
            for number in order.get_ready():
                heapq.heappush(waiting, (-depths[number], number))
            while idle and waiting:
                process, number = idle.pop(), heapq.heappop(waiting)[1]
                process.start(signatures[number])
                running[process.fileno()] = process, number
            report(f"{done} of {len(signatures)}")
            for ready in wait(list(running), POLL_S):
                process, number = running[cast(int, ready)]
                if process.is_finished():
                    del running[process.fileno()]
                    order.done(number)
                    idle.append(process)
                    done += 1


def find_callees(signatures: Sequence[Signature]) -> dict[int, set[int]]:
    """Return by the index of each kernel those of the kernels that its code calls."""
    from vo_service.kernels.argument_types import find_object  # imports Numba

    numbers: dict[str, list[int]] = {}
    for number, signature in enumerate(signatures):
        numbers.setdefault(signature.kernel, []).append(number)
    return {
        number: {
            callee
            for name in _called_kernels(find_object(signature.kernel), numbers)
            for callee in numbers[name]
        }
        for number, signature in enumerate(signatures)
    }


def _called_kernels(kernel: Any, listed: dict[str, list[int]]) -> Iterator[str]:
    """Names of the listed kernels that a kernel calls, itself or through inlined functions."""
    function = kernel.py_func
    for name in function.__code__.co_names:
        callee = function.__globals__.get(name)
        if not hasattr(callee, "py_func"):
            continue
        full_name = f"{callee.py_func.__module__}.{callee.py_func.__qualname__}"
        if full_name in listed:
            yield full_name
        else:
            yield from _called_kernels(callee, listed)


def _call_depths(callees: dict[int, set[int]]) -> dict[int, int]:
    """Return by kernel the length of the longest chain of calls that leads to it."""
    depths = dict.fromkeys(callees, 0)
    for number in reversed(list(TopologicalSorter(callees).static_order())):
        for callee in callees[number]:
            depths[callee] = max(depths[callee], depths[number] + 1)
    return depths


def process_count() -> int:
    """Return how many processes compile: one on each processor, as far as there is memory."""
    by_memory = int(available_memory_bytes() // PROCESS_BYTES)
    return max(1, min(len(os.sched_getaffinity(0)), by_memory))
