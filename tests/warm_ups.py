"""Warm-ups of kernels: a process needs each only once, and tests start many commands in one."""

from collections.abc import Callable
from importlib import import_module

import pytest

# Warm-up functions, by the modules that call them.
_CALLERS = {
    "vo_service.slam.mapper.loop_closure_worker": "warm_up_loop_closure",
    "vo_service.slam.synchronous_loop_closure": "warm_up_loop_closure",
}
WarmUp = Callable[..., None]


def skip_repeated_warm_ups(patch: pytest.MonkeyPatch) -> None:
    """Let each warm-up of this process, and of those forked from it, run once."""
    run_once: dict[WarmUp, WarmUp] = {}
    for caller, name in _CALLERS.items():
        module = import_module(caller)
        warm_up: WarmUp = getattr(module, name)
        patch.setattr(module, name, run_once.setdefault(warm_up, _run_once(warm_up)))


def _run_once(warm_up: WarmUp) -> WarmUp:
    done: set[tuple[object, ...]] = set()

    def run(*arguments: object) -> None:
        *what, _report_stage = arguments
        if tuple(what) not in done:
            warm_up(*arguments)
            done.add(tuple(what))

    return run
