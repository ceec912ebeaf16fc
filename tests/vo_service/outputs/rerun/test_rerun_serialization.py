"""Messages arrive as they were sent, whatever the size and layout of their arrays."""

from multiprocessing import Pipe

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from vo_service.outputs.rerun.bounded_trajectory import MIN_POINT_DISTANCE_M, BoundedTrajectory
from vo_service.outputs.rerun.messages import GroundTruth, RerunMessage, TextLog
from vo_service.outputs.rerun.serialization import receive_message, serialize


def send_and_receive(*messages: RerunMessage) -> list[RerunMessage]:
    sender, receiver = Pipe()
    with sender, receiver:
        for message in messages:
            for part in serialize(message):
                sender.send_bytes(part)
        return [receive_message(receiver) for _ in messages]


@given(arrays.arrays(np.float64, st.tuples(st.integers(0, 20), st.just(3))), st.booleans())
def test_arrays_are_restored(positions: np.ndarray, is_turned: bool) -> None:
    array = positions[::-1, ::2] if is_turned else positions
    ground_truth, text_log = send_and_receive(GroundTruth(array), TextLog("on"))
    assert isinstance(ground_truth, GroundTruth)
    np.testing.assert_array_equal(ground_truth.positions, array)
    assert text_log == TextLog("on")


@given(st.lists(st.tuples(st.floats(-9, 9), st.integers(0, 3)), max_size=200))
def test_a_trajectory_is_bounded_and_ends_at_the_camera(steps: list[tuple[float, int]]) -> None:
    trajectory = BoundedTrajectory(max_points=16)
    for x, epoch in steps:
        position = np.array([x, 0.0, 0.0])
        trajectory.add(position, epoch)
        assert 1 <= sum(map(len, trajectory.lines)) <= 16
        assert abs(trajectory.lines[-1][-1][0] - x) < MIN_POINT_DISTANCE_M
