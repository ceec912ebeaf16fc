from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from drivers.core import CameraError
from drivers.freenect.bindings import TimeValue
from drivers.freenect.context import FreenectContext
from drivers.freenect.log import LibfreenectLog


def library(**answers: int) -> Any:
    """A libfreenect that answers 0, or what is said here: for answers that no stand-in gives."""
    answers = {"init": 0, "process_events_timeout": 0} | answers
    calls = {f"freenect_{name}": MagicMock(return_value=value) for name, value in answers.items()}
    rest = ("set_log_callback", "set_log_level", "select_subdevices", "shutdown")
    return SimpleNamespace(**calls, **{f"freenect_{name}": MagicMock() for name in rest})


@pytest.mark.parametrize(("result", "goes_on"), [(0, True), (10, True), (-10, True), (-1, False)])
def test_only_real_errors_end_the_event_loop(result: int, goes_on: bool) -> None:
    context = FreenectContext(library(process_events_timeout=result), LibfreenectLog())
    assert context.make_event_processor(TimeValue(0, 0))() is goes_on


def test_an_exception_in_a_callback_leaves_the_event_loop() -> None:
    context = FreenectContext(library(), LibfreenectLog())

    def fails(pixels: int, stamp: int) -> None:
        raise CameraError(f"{pixels} {stamp}")

    context.make_callback(fails)(None, 7, 8)
    with pytest.raises(CameraError, match="7 8"):
        context.make_event_processor(TimeValue(0, 0))()


def test_a_machine_without_usb_is_an_error() -> None:
    with pytest.raises(CameraError, match="/dev/bus/usb"):
        FreenectContext(library(init=-99), LibfreenectLog())
