import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.freenect.valid_depth import (
    MAX_DEPTH_MM,
    ValidDepthMask,
    all_depths_to_10_m,
    find_valid_depths_mm,
)
from tests.drivers.freenect.conftest import MakeCamera, plug_in
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.kinect_registration import raw_to_mm
from tests.simulators.kinect_simulator import FACTORY


def table(*ends: int) -> np.ndarray[tuple[int], np.dtype[np.uint16]]:
    """A table as libfreenect's: 1000 values that rise from 400 mm, then `ends`."""
    return np.array([*range(400, 5400, 5), *ends], dtype=np.uint16)


def test_ambiguous_wrapped_values_are_invalid() -> None:
    measured = find_valid_depths_mm(table(20_000, 61_000, 5000, 7000, 0))
    assert set(measured) == set(range(400, 5400, 5)) - {5000}


def test_without_a_far_range_the_table_ends_where_it_decreases() -> None:
    assert find_valid_depths_mm(table(300, 401, 0)).tolist() == list(range(400, 5400, 5))


@pytest.mark.slow
@given(st.lists(st.integers(0, 65535), max_size=300))
def test_only_the_increasing_part_below_10_m_is_valid(ends: list[int]) -> None:
    values = table(*ends)
    measured = set(find_valid_depths_mm(values).tolist())
    for raw, mm in enumerate(values.tolist()):
        if mm in measured:
            assert mm < MAX_DEPTH_MM
            assert (values[: raw + 1] == np.maximum.accumulate(values[: raw + 1])).all()


def test_the_filter_sets_invalid_depth_to_0() -> None:
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    kept = ValidDepthMask(find_valid_depths_mm(table(5000)))(every)
    assert set(np.unique(kept)) == {0} | set(range(400, 5400, 5)) - {5000}
    assert (kept[kept > 0] == every[kept > 0]).all()
    assert np.array_equal(
        ValidDepthMask(all_depths_to_10_m())(every), every * (every < MAX_DEPTH_MM)
    )


def test_a_kinects_own_table_is_split_at_the_pole_of_its_formula(
    simulate_kinect: SimulateKinect, make_camera: MakeCamera
) -> None:
    plug_in(simulate_kinect, registration=FACTORY)
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    with make_camera() as camera:
        kept = camera._depth_filter(every)
    usable = set(raw_to_mm(np.arange(2048, dtype=np.uint16)).tolist()) - {0}
    assert set(np.unique(kept)) - {0} <= usable
    assert len(usable - set(np.unique(kept))) < 0.01 * len(usable)
