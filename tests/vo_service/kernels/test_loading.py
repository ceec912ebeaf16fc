"""Compiled kernels are loaded in the order of their use, and no longer than they are wanted."""

import threading
from dataclasses import dataclass

import pytest

from vo_service.kernels import loading
from vo_service.kernels.loading import load_kernels, loading_in_background


@dataclass(frozen=True)
class FakeKernel:
    name: str
    part: str
    is_called: bool
    loaded: list[str]

    @property
    def signature(self) -> "FakeKernel":
        return self

    def compile(self) -> None:
        self.loaded.append(self.name)


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    names: list[str] = []
    kernels = [
        FakeKernel("first", "direct", True, names),
        FakeKernel("inlined", "direct", False, names),
        FakeKernel("of another part", "icp", True, names),
        FakeKernel("second", "direct", True, names),
    ]
    monkeypatch.setattr(loading, "read_kernel_list", lambda: kernels)
    return names


def test_the_kernels_that_python_calls_are_loaded_in_their_order(loaded: list[str]) -> None:
    load_kernels("direct", threading.Event())
    assert loaded == ["first", "second"]


def test_nothing_is_loaded_after_a_stop(loaded: list[str]) -> None:
    stop = threading.Event()
    stop.set()
    load_kernels("direct", stop)
    assert loaded == []


def test_loading_in_the_background_ends_with_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()

    def wait_for_stop(_part: str, stop: threading.Event) -> None:
        begun.set()
        assert stop.wait(20.0)

    monkeypatch.setattr(loading, "load_kernels", wait_for_stop)
    with loading_in_background("direct"):
        assert begun.wait(20.0)
    assert "kernels" not in {thread.name for thread in threading.enumerate()}
