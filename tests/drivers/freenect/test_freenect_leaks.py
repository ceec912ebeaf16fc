import pytest

from tests.belongings import belongings
from tests.drivers.freenect.conftest import plug_in
from tests.drivers.freenect.replugging import Held, held, isolated_kinect, replug
from tests.stand_ins.fixtures import PlayKinect
from tests.stand_ins.played_kinect import Model
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

# What is kept of a time that is over would be the images of both streams, 12 MB.
GROWTH_KB = 30_000


def holds_no_more(now: Held, before: Held) -> bool:
    grown_kb = now.memory_kb - before.memory_kb
    processes = now.here <= before.here and now.driver <= before.driver
    return processes and now.kinect == before.kinect and grown_kb < GROWTH_KB


@pytest.mark.parametrize("model", [Model.K1414, Model.K1473])
def test_a_kinect_that_comes_and_goes_leaves_nothing_in_either_process(
    model: Model, play_kinect: PlayKinect
) -> None:
    kinect = plug_in(play_kinect, model=model)
    before = belongings()
    with isolated_kinect() as camera:
        camera.read(100.0)
        replug(camera, kinect)
        first = held(kinect)
        for _ in range(9):
            replug(camera, kinect)
        # What comes and goes by itself may be there at one instant; what leaked stays.
        wait_until(lambda: holds_no_more(held(kinect), first), f"to hold no more than {first}")
    assert belongings() <= before
    assert (kinect.open_handles, kinect.submitted_transfers) == (0, (0, 0))
