"""The table of faults for users has every fault that the tests let happen, with what is said."""

from pathlib import Path

import pytest

from tests.vo_service.environment_faults import ENVIRONMENT_FAULTS, EnvironmentFault
from tests.vo_service.frame_faults import FRAME_FAULTS, FrameFault
from tests.vo_service.lifecycle_stages import STAGES
from tests.vo_service.sensor_faults import SENSOR_FAULTS, SensorFault

PAGE = (Path(__file__).parents[2] / "docs" / "design" / "faults.md").read_text(encoding="utf-8")
Fault = SensorFault | FrameFault | EnvironmentFault
ALL: tuple[Fault, ...] = (*SENSOR_FAULTS, *FRAME_FAULTS, *ENVIRONMENT_FAULTS)


def row_of(name: str) -> str:
    """The only row about it."""
    cells = [(line, line.split("|")[1].strip()) for line in PAGE.splitlines() if line[:1] == "|"]
    (row,) = [line for line, first in cells if first.split(":")[0].split(",")[0] == name]
    return row


@pytest.mark.parametrize("fault", ALL, ids=lambda fault: fault.name.replace(" ", "-"))
def test_the_documentation_has_the_reported_messages(fault: Fault) -> None:
    words = fault.status_text.split(" (")[0].strip()
    assert words in row_of(fault.name)


@pytest.mark.parametrize("fault", SENSOR_FAULTS, ids=lambda fault: fault.name.replace(" ", "-"))
def test_the_documentation_has_the_limits_of_the_benchmark(fault: SensorFault) -> None:
    report_s, recovery_s = (float(cell) for cell in row_of(fault.name).split("|")[3:5])
    assert (report_s, recovery_s) == (fault.max_report_s, fault.max_recovery_s)


@pytest.mark.parametrize("fault", FRAME_FAULTS, ids=lambda fault: fault.name.replace(" ", "-"))
def test_the_documentation_has_the_state_of_the_poses(fault: FrameFault) -> None:
    assert f"`{fault.state}`" in row_of(fault.name) or not fault.state


def test_the_documentation_has_every_state_in_which_a_signal_may_come() -> None:
    (heading,) = [line for line in PAGE.splitlines() if line.startswith("| signal")]
    assert all(stage.name in heading for stage in STAGES)
