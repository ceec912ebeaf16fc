import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.fixtures import pattern_frame

FRAMES = 12

pytestmark = [pytest.mark.subprocess, pytest.mark.usefixtures("fakenect")]


@pytest.fixture(scope="module")
def dump_frames() -> list[tuple[Any, Any]]:
    """Frames with depth over 10 m, too, which is no reading."""
    frames = [pattern_frame(seq) for seq in range(FRAMES)]
    for _, depth in frames:
        depth[300:310] = 10_000
    return frames


def play(dump: Path, pace: str = "lockstep") -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "tests.drivers.freenect.play_fakenect_dump"]
    return subprocess.run(
        [*command, str(dump), pace, str(dump / "played.npz")],
        capture_output=True,
        text=True,
        timeout=100,
    )


def played(dump: Path, pace: str = "lockstep") -> Any:
    """What the camera delivered."""
    result = play(dump, pace)
    assert result.returncode == 0, result.stderr
    return np.load(dump / "played.npz")


def test_a_dump_is_replayed_bit_for_bit_twice(
    dump_frames: list[tuple[Any, Any]], tmp_path: Path
) -> None:
    write_fakenect_dump(tmp_path, dump_frames, rate_hz=300.0)
    frames = played(tmp_path)
    for seq, (bgr, depth) in enumerate(dump_frames):
        assert np.array_equal(frames["color"][seq], bgr)
        assert np.array_equal(frames["depth"][seq], np.where(depth < 10_000, depth, 0))
    assert frames["seq"].tolist() == list(range(FRAMES))
    assert frames["again"] == FRAMES


@pytest.mark.parametrize("offset_s", [0.009, -0.009])
def test_stamps_are_the_recorded_ones_across_the_wrap(
    dump_frames: list[tuple[Any, Any]], offset_s: float, tmp_path: Path
) -> None:
    start_ticks = 2**32 - 60_000_000 // 10
    write_fakenect_dump(tmp_path, dump_frames, start_ticks=start_ticks, color_offset_s=offset_s)
    frames = played(tmp_path)
    expected_s = start_ticks / 60e6 + np.arange(FRAMES) / 30 + offset_s
    np.testing.assert_allclose(frames["device_stamp_s"], expected_s, atol=1e-6)
    np.testing.assert_array_equal(frames["stamp_s"], frames["device_stamp_s"])
    np.testing.assert_allclose(frames["skew_s"], -offset_s, atol=1e-6)


def test_in_real_time_the_newest_is_read(
    dump_frames: list[tuple[Any, Any]], tmp_path: Path
) -> None:
    write_fakenect_dump(tmp_path, dump_frames)
    seqs = played(tmp_path, "realtime")["seq"].tolist()
    assert seqs == sorted(set(seqs))
    assert seqs[-1] == FRAMES - 1


def test_raw_depth_is_rejected_with_its_format(tmp_path: Path) -> None:
    raw = np.full((480, 640), 800, np.uint16)
    raw[:50] = 2047
    write_fakenect_dump(tmp_path, [(pattern_frame(0)[0], raw)])
    result = play(tmp_path)
    assert result.returncode == 1
    assert "InputError" in result.stderr
    assert "raw 11-bit depth" in result.stderr
