import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.freenect.depth_tables import MAX_DEPTH_MM, DepthTables, find_valid_depths_mm


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


def test_values_without_a_reading_have_no_distance() -> None:
    raw_to_mm = table(20_000, 5000, 0)
    tables = DepthTables(raw_to_mm, np.zeros(0, np.int32), np.zeros(0, np.int32), 0)
    assert tables.valid_mm.tolist() == [mm if mm != 5000 else 0 for mm in range(400, 5400, 5)] + [
        0, 0, 0,
    ]  # fmt: skip
