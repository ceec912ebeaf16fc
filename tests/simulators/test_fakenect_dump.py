"""Debian's fakenect reads the dump back; it ends the process when a file is wrong."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.fixtures import pattern_frame

pytestmark = pytest.mark.subprocess

ROOT = Path(__file__).parents[2]
FRAMES = 6
READ = """
import json, sys
import numpy as np
from tests.simulators.freenect_probe import FreenectProbe, TiltState
probe = FreenectProbe(library=sys.argv[1])
assert probe.start() == (0, 0)
while probe.process() == 0:
    pass
probe.lib.freenect_update_tilt_state(probe.device)
state = probe.lib.freenect_get_tilt_state(probe.device).contents
np.savez(sys.argv[2], depth=probe.depth.images, video=probe.video.images)
stamps = [probe.depth.stamps, probe.video.stamps]
print(json.dumps(stamps + [[state.x, state.y, state.z]]), flush=True)
"""


def test_frames_stamps_and_gravity_come_back_as_they_were(fakenect: Path, tmp_path: Path) -> None:
    frames = [pattern_frame(seq) for seq in range(FRAMES)]
    start_ticks = 2**32 - 4_000_000
    count = write_fakenect_dump(
        tmp_path / "dump", frames, start_ticks=start_ticks, acceleration=(1, -819, 7)
    )
    out = tmp_path / "out.npz"
    result = subprocess.run(
        [sys.executable, "-c", READ, str(fakenect), str(out)],
        cwd=ROOT,
        env=os.environ | {"FAKENECT_PATH": str(tmp_path / "dump")},
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    # fakenect prints too, and its lines may come before or after.
    reply = next(line for line in result.stdout.splitlines() if line.startswith("[["))
    depth_stamps, video_stamps, gravity = json.loads(reply)
    expected = [(start_ticks + 2_000_000 * seq) % 2**32 for seq in range(count)]
    assert depth_stamps == video_stamps == expected
    assert gravity == [1, -819, 7]
    images = np.load(out)
    assert np.array_equal(images["depth"], [depth for _, depth in frames])
    assert np.array_equal(images["video"], [bgr[:, :, ::-1] for bgr, _ in frames])
