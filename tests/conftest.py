"""Fixtures of all tests: a small recording, rendered once a session, and the real recordings."""

# Imported before numpy, as in the program: tests run in parallel, and idle threads would spin.
import vo_service.tools.compare.single_thread  # noqa: F401

# isort: split

import ctypes
import gc
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import hypothesis
import numpy as np
import pytest

from drivers.core.folders import kernel_folder

# Set before any import that compiles; processes that tests start use the same kernels.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_folder()))

from drivers.core.geometry import Array, Trajectory, rigid_transform, so3_exp
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from tests.forked_process import WORKERS, forked_workers
from tests.simulators.fixtures import (  # noqa: F401
    fakenect,
    kinect_frames,
    no_real_usb,
    real_libfreenect,
    real_openni2,
    simulate_kinect,
    simulated_libusb,
)
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.warm_ups import skip_repeated_warm_ups

cv2.setNumThreads(1)

# The images of one test take the memory of those before: the system returns it only after setting
# each page to zero. See M_TRIM_THRESHOLD and M_MMAP_THRESHOLD in mallopt(3).
for _parameter, _bytes in ((-1, 256_000_000), (-3, 32_000_000)):
    ctypes.CDLL(None).mallopt(_parameter, _bytes)

# A shell that runs the tests in the background ignores Ctrl-C, and child processes inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # and nohup that of a closed terminal

# A slow machine must not fail a test. Examples differ in each run.
hypothesis.settings.register_profile("tests", deadline=None, max_examples=50)
hypothesis.settings.load_profile("tests")

FRAMES = 12
# Markers, and the fixtures that add them to every test that uses one, directly or indirectly.
MARKING_FIXTURES = {
    "hardware_simulator": {"simulated_libusb", "real_libfreenect", "real_openni2", "fakenect"},
    "slow": {"photographs"},
}


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark tests by their fixtures."""
    fixtures = set(getattr(item, "fixturenames", ()))
    for marker, marking in MARKING_FIXTURES.items():
        if fixtures & marking:
            item.add_marker(marker)


# Test collection creates no garbage.
gc.disable()


def pytest_collection_finish() -> None:
    """Exclude the collected tests from later garbage collections."""
    gc.enable()
    gc.freeze()


def _hand_held_pose(seq: int) -> Array:
    """Pose of a hand that moves a little forward and to the right, turning."""
    turn = so3_exp([0.002 * seq, 0.006 * seq, -0.003 * seq])
    return rigid_transform(turn, [0.01 * seq, -0.004 * seq, 0.015 * seq])


@pytest.fixture(scope="session", autouse=True)
def single_warm_ups() -> Iterator[None]:
    """Load kernels once: see `tests.warm_ups`."""
    with pytest.MonkeyPatch.context() as patch:
        skip_repeated_warm_ups(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def fork_workers() -> Iterator[None]:
    """Fork the worker processes of cameras, maps and recorders: see `tests.forked_process`."""
    with forked_workers(WORKERS):
        yield


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A read-only folder of 12 frames, 320x240, 30 per second, with ground truth."""
    folder = tmp_path_factory.mktemp("recordings") / "corner"
    frames = [render_corner(_hand_held_pose(seq), seq) for seq in range(FRAMES)]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    truth = Trajectory(stamps_s, np.array([_hand_held_pose(seq) for seq in range(FRAMES)]))
    with FrameRecorder(TumFolder(folder, ground_truth=truth)) as writer:
        for frame in frames:
            writer.write(frame)
    return folder


@pytest.fixture
def copy_recording(recording: Path, tmp_path: Path) -> Callable[..., Path]:
    """A function that copies the recording; ``lists=True`` omits associations.txt."""

    def copy(lists: bool = False, name: str = "corner") -> Path:
        folder = Path(shutil.copytree(recording, tmp_path / name))
        if lists:
            (folder / "associations.txt").unlink()
        return folder

    return copy


@pytest.fixture
def recordings() -> Path:
    """The folder of real recordings."""
    folder = os.environ.get("KINECT_VO_DATA")
    if folder is None:
        pytest.skip("needs the real recordings: set KINECT_VO_DATA to their folder")
    return Path(folder)
