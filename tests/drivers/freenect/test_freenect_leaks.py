import pytest

from tests.drivers.freenect.conftest import plug_in
from tests.drivers.freenect.replugging import (
    HeldResources,
    count_resources,
    kinect_in_subprocess,
    replug,
)
from tests.resource_leaks import resources_in_use
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_simulator import KinectModel
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

# What is kept of a time that is over would be the images of both streams, 12 MB each time.
GROWTH_KB = 15_000


def holds_no_more(now: HeldResources, before: HeldResources) -> bool:
    grown_kb = now.memory_kb - before.memory_kb
    processes = now.here <= before.here and now.driver <= before.driver
    return processes and now.kinect == before.kinect and grown_kb < GROWTH_KB


@pytest.mark.parametrize("model", [KinectModel.K1414, KinectModel.K1473])
def test_repeated_replugging_leaks_nothing_in_either_process(
    model: KinectModel, simulate_kinect: SimulateKinect
) -> None:
    kinect = plug_in(simulate_kinect, model=model)
    before = resources_in_use()
    with kinect_in_subprocess() as camera:
        camera.read(100.0)
        replug(camera, kinect)
        first = count_resources(kinect)
        for _ in range(4):
            replug(camera, kinect)
        # What comes and goes by itself may be there at one instant; what leaked stays.
        wait_until(
            lambda: holds_no_more(count_resources(kinect), first),
            lambda: f"{count_resources(kinect)} to be no more than {first}",
        )
    assert resources_in_use() <= before
    assert (kinect.open_handles, kinect.submitted_transfers) == (0, (0, 0))
