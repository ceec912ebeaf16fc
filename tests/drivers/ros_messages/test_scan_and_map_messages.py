"""Scan and occupancy grid against rosbags' own serializer."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.ros_messages.decoding import decode_laser_scan, decode_occupancy_grid
from drivers.ros_messages.navigation import (
    OCCUPANCY_GRID_SCHEMA,
    OccupancyGridMessage,
    encode_occupancy_grid,
)
from drivers.ros_messages.sensors import LASER_SCAN_SCHEMA, LaserScanMessage, encode_laser_scan
from tests.drivers.ros_messages.rosbags_reader import (
    check_header,
    frame_ids,
    read_with_rosbags,
    stamps,
)

angles = st.floats(-3.0, 3.0, width=32)


def example(ranges_m: Any, **changes: Any) -> LaserScanMessage:
    fields: dict[str, Any] = {
        "stamp_s": 1.5,
        "frame_id": "camera_scan",
        "angle_min_rad": -0.5,
        "angle_increment_rad": 0.00875,
        "scan_time_s": 0.03125,
        "range_min_m": 0.45,
        "range_max_m": 4.5,
    }
    return LaserScanMessage(ranges_m=np.asarray(ranges_m, np.float32), **{**fields, **changes})


@given(stamps, frame_ids, angles, st.data(), st.integers(0, 130))
def test_a_scan(
    stamp_s: float, frame_id: str, angle: float, data: st.DataObject, count: int
) -> None:
    ranges = data.draw(arrays(np.float32, count))
    message = example(ranges, stamp_s=stamp_s, frame_id=frame_id, angle_min_rad=angle)
    encoded = encode_laser_scan(message)
    ros = read_with_rosbags(encoded, LASER_SCAN_SCHEMA)
    check_header(ros, stamp_s, frame_id)
    np.testing.assert_array_equal(ros.ranges, ranges)
    assert ros.angle_max == pytest.approx(angle + (count - 1) * 0.00875, abs=1e-5)
    assert (ros.time_increment, len(ros.intensities)) == (0.0, 0)
    decoded = decode_laser_scan(encoded)
    np.testing.assert_array_equal(decoded.ranges_m, ranges)
    assert decoded.angle_min_rad == angle
    assert decoded.frame_id == frame_id
    assert len(decoded.angles_rad) == count


cells = arrays(np.int8, st.tuples(st.integers(0, 9), st.integers(0, 9)))


@given(stamps, frame_ids, st.floats(-1e6, 1e6), cells)
def test_a_grid(stamp_s: float, frame_id: str, x: float, cells: Any) -> None:
    message = OccupancyGridMessage(stamp_s, frame_id, 0.0625, (x, -x), cells)
    encoded = encode_occupancy_grid(message)
    ros = read_with_rosbags(encoded, OCCUPANCY_GRID_SCHEMA)
    assert (ros.info.height, ros.info.width) == cells.shape
    assert (ros.info.origin.position.x, ros.info.origin.position.y) == (x, -x)
    assert (ros.info.origin.orientation.z, ros.info.origin.orientation.w) == (0.0, 1.0)
    assert (ros.info.map_load_time.sec, ros.info.resolution) == (0, 0.0625)
    np.testing.assert_array_equal(ros.data, cells.ravel())
    decoded = decode_occupancy_grid(encoded)
    np.testing.assert_array_equal(decoded.cells, cells)
    assert decoded.origin_xy_m == (x, -x)
    assert decoded.resolution_m == 0.0625


def test_truncated_messages_are_rejected() -> None:
    scan = encode_laser_scan(example(np.zeros(9)))
    grid = encode_occupancy_grid(
        OccupancyGridMessage(0.0, "map", 0.05, (0.0, 0.0), np.zeros((3, 3), np.int8))
    )
    for length in (3, 12, 30, 60):
        with pytest.raises(ValueError, match=r"CDR|LaserScan"):
            decode_laser_scan(scan[:length])
        with pytest.raises(ValueError, match=r"CDR|OccupancyGrid"):
            decode_occupancy_grid(grid[:length])


def test_a_map_whose_origin_is_not_finite_is_never_encoded() -> None:
    cells = np.zeros((1, 1), np.int8)
    with pytest.raises(ValueError, match="not finite"):
        encode_occupancy_grid(OccupancyGridMessage(0.0, "map", 0.05, (np.nan, 0.0), cells))
