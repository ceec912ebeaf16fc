import pytest

from tests.belongings import belongings
from tests.drivers.freenect.conftest import plug_in
from tests.drivers.freenect.replugging import held, isolated_kinect, replug
from tests.stand_ins.fixtures import PlayKinect
from tests.stand_ins.played_kinect import Model

# What is kept of a time that is over would be the images of both streams, 12 MB.
GROWTH_KB = 30_000


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
        last = held(kinect)
    assert last.here <= first.here
    assert last.driver <= first.driver
    assert last.kinect == first.kinect
    assert last.memory_kb - first.memory_kb < GROWTH_KB
    assert belongings() <= before
    assert (kinect.open_handles, kinect.submitted_transfers) == (0, (0, 0))
