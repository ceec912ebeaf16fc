"""The warm-up compiles all kernels of the loop closure."""

import sys
from typing import Any

from tests.vo_service.slam.loop_closure.corner_trajectory import STEPS, make_loop_closer
from vo_service.slam.loop_closure.warm_up import warm_up_loop_closure


def kernels() -> dict[str, list[Any]]:
    """All kernels that are loaded, by name, with what they are compiled for."""
    return {
        f"{module}.{name}": list(each.signatures)
        for module, content in list(sys.modules.items())
        if module.startswith("vo_service.")
        for name, each in list(vars(content).items())
        if hasattr(each, "signatures") and hasattr(each, "py_func")
    }


def test_its_only_stage_is_reported_and_a_loop_closure_compiles_nothing() -> None:
    sample_edges: list[str] = []
    assert warm_up_loop_closure(sample_edges.append) > 0
    assert sample_edges == ["place recognition"]
    before = kernels()
    assert sum(map(bool, before.values())) > 5
    assert make_loop_closer(2 * STEPS + 1).loop_count > 0
    assert kernels() == before
